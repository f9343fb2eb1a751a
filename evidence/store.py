"""Results of long evidence in a journal file that survives a kill and is read at the next start.

One process writes the journal. Each result is one line with its key, and is synchronised to the
disk at once. A later line of the same key replaces an earlier one. The next start discards a line
that a crash has cut off, so its case runs again.
"""

import json
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from file_delivery.durable import replace_file, sync_file
from hil.errors import make_folder, same_settings
from hil.world.scenario import ScenarioError

JOURNAL = "results.jsonl"

Row = Mapping[str, Any]  # plain values of JSON


@contextmanager
def results_in(out: Path | None) -> Iterator[Path]:
    """Make and yield `out`, or a temporary folder if None. Raise ScenarioError if impossible."""
    with ExitStack() as stack:
        folder = out or Path(stack.enter_context(TemporaryDirectory(prefix="hil-")))
        make_folder(folder)
        yield folder


class Store:
    """Results in a journal file in a folder: one row of JSON values for each key.

    Without a folder, the results are kept in memory only.
    """

    def __init__(self, folder: Path | None, settings: Mapping[str, Any]) -> None:
        """Open or make the folder and read its rows.

        Parameters
        ----------
        settings : values on which every row depends, besides its key and the code

        Raises
        ------
        ScenarioError for a folder that cannot be made, or that holds results of other settings or
        of another version.
        """
        self.folder = folder
        self._path: Path | None = None
        self._rows: dict[str, Row] = {}
        if folder is None:
            return
        same_settings(folder, settings)
        self._path = folder / JOURNAL
        if self._path.exists():
            whole = self._path.read_bytes()
            end = whole.rfind(b"\n") + 1
            if end != len(whole):
                os.truncate(self._path, end)
            self._rows = dict(_read(self._path, line) for line in whole[:end].splitlines())

    @property
    def rows(self) -> Mapping[str, Row]:
        """All rows by key, in the order in which the keys were first added."""
        return self._rows

    def add(self, key: str, row: Row) -> None:
        """Keep a row; when this function returns, the row is on the disk."""
        self._rows[key] = row
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(_line(key, row))
                sync_file(file)

    def forget(self, keys: Collection[str]) -> None:
        """Discard rows, so that their cases run again."""
        self._rows = {key: row for key, row in self._rows.items() if key not in keys}
        if self._path is not None:
            replace_file(self._path, "".join(_line(*item) for item in self._rows.items()))


def _read(path: Path, line: bytes) -> tuple[str, Row]:
    try:
        key, row = json.loads(line)
    except (ValueError, TypeError) as error:
        raise ScenarioError(f"{path}: results of another version; give an empty folder") from error
    if not isinstance(key, str) or not isinstance(row, dict):
        raise ScenarioError(f"{path}: results of another version; give an empty folder")
    return key, row


def _line(key: str, row: Row) -> str:
    return json.dumps([key, row]) + "\n"
