"""Results of a campaign on disk: a journal that survives a kill, and the table made of it.

The driver alone writes, one flushed line per finished run; a line cut off by a kill is dropped at
the next start and its run is done again. Keys tell runs apart, so none counts twice.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from hil.errors import make_folder
from hil.evidence.campaign.config import Campaign
from hil.world.scenario import ScenarioError

JOURNAL, TABLE, CAMPAIGN = "journal.jsonl", "results.parquet", "campaign.json"


class Store:
    """One folder."""

    def __init__(self, folder: Path, campaign: Campaign) -> None:
        make_folder(folder)
        self._folder, self._journal = folder, folder / JOURNAL
        text = campaign.model_dump_json()
        known = folder / CAMPAIGN
        if known.exists() and known.read_text(encoding="utf-8") != text:
            raise ScenarioError(f"{known}: results of another campaign; choose another --out")
        known.write_text(text, encoding="utf-8")
        if self._journal.exists():
            whole = self._journal.read_bytes()
            end = whole.rfind(b"\n") + 1
            if end != len(whole):
                with self._journal.open("r+b") as file:
                    file.truncate(end)

    def rows(self) -> dict[str, dict[str, Any]]:
        """Return the finished runs by key."""
        if not self._journal.exists():
            return {}
        with self._journal.open(encoding="utf-8") as lines:
            return {row["key"]: row for row in map(json.loads, lines)}

    def add(self, row: dict[str, Any]) -> None:
        """Write a finished run and see it to the disk."""
        with self._journal.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
            file.flush()
            os.fsync(file.fileno())

    def write_table(self, rows: list[dict[str, Any]]) -> Path:
        """Write the runs as Parquet, in the order given; return its path."""
        import pyarrow
        from pyarrow import parquet

        path = self._folder / TABLE
        parquet.write_table(pyarrow.Table.from_pylist(rows), path)
        return path
