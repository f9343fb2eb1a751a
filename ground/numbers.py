"""A number kept in a file that several programs change, and that no crash sets back."""

import fcntl
import json
from collections.abc import Callable
from pathlib import Path

from file_delivery.durable import replace_file
from ground.errors import UsageError


class NumberFile:
    """The next number of something; 0 when there is no file.

    Parameters
    ----------
    path : ends in .json; beside it lies a lock
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    @property
    def is_new(self) -> bool:
        """Whether nothing was ever kept."""
        return not self._path.exists()

    def change(self, step: Callable[[int], int]) -> int:
        """Replace the number by `step` of it, on the disk when this returns; return the old one.

        Raises
        ------
        UsageError when the file is damaged or cannot be written.
        """
        try:
            return self._change(step)
        except OSError as error:
            raise UsageError(f"{self._path}: {error.strerror}") from error
        except (ValueError, KeyError, TypeError) as error:
            raise UsageError(f"{self._path}: damaged; remove it, no IV is used twice") from error

    def _change(self, step: Callable[[int], int]) -> int:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            current = 0 if self.is_new else int(json.loads(self._path.read_text())["next"])
            replace_file(self._path, json.dumps({"next": step(current)}))
        return current
