"""A number in a file: several programs may change the number, and no crash sets it back."""

import json
from collections.abc import Callable
from pathlib import Path

from file_delivery.durable import replace_file
from file_delivery.locks import locked
from ground.errors import UsageError
from ground.state_folder import made

WAIT_S = 5.0  # for another program that changes the number


class NumberFile:
    """A file that stores the next number of a series; 0 when there is no file.

    Parameters
    ----------
    path : path of the file, ends in .json; a lock file is placed beside it
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    @property
    def is_new(self) -> bool:
        """Whether no number has been stored yet."""
        return not self._path.exists()

    def change(self, step: Callable[[int], int]) -> int:
        """Store `step(number)` on the disk in place of the number; return the old number.

        Raises
        ------
        UsageError when the file is damaged or cannot be written.
        """
        try:
            return self._change(step)
        except OSError as error:
            raise UsageError(f"{self._path}: {error.strerror}") from error
        except (ValueError, LookupError, TypeError, ArithmeticError, RecursionError) as error:
            raise UsageError(f"{self._path}: damaged; remove it, no IV is used twice") from error

    def _change(self, step: Callable[[int], int]) -> int:
        made(self._path.parent)
        with locked(self._path.with_suffix(".lock"), WAIT_S):
            current = 0 if self.is_new else int(json.loads(self._path.read_text())["next"])
            replace_file(self._path, json.dumps({"next": step(current)}))
        return current
