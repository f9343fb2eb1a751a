"""Results on disk: one JSON line each, appended and flushed as they come, read again on a rerun.

Each line names the commit of the code that gave it, so a study whose methods changed on the way
says which result is whose.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Collection, Iterable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import same_settings
from hil.evidence.methods.cases import Key, Record, settings
from hil.world.inertia import FloatArray

RESULTS = "results.jsonl"


class Store:
    """The results of one folder. A line cut off by a crash is dropped at the next start."""

    def __init__(self, folder: Path) -> None:
        same_settings(folder, settings())
        self.path = folder / RESULTS
        if self.path.exists():
            whole = self.path.read_bytes()
            end = whole.rfind(b"\n") + 1
            if end != len(whole):
                self.path.write_bytes(whole[:end])

    def records(self) -> dict[Key, Record]:
        """Return all stored records."""
        if not self.path.exists():
            return {}
        with self.path.open(encoding="utf-8") as lines:
            found = [_record(json.loads(line)) for line in lines]
        return {record.key: record for record in found}

    def forget(self, methods: Collection[str]) -> None:
        """Drop the results of some methods, so that they are run again."""
        kept = [r for r in self.records().values() if r.key.method not in methods]
        fresh = self.path.with_suffix(".new")
        fresh.write_text("".join(f"{json.dumps(_plain(r))}\n" for r in kept), encoding="utf-8")
        fresh.replace(self.path)

    def append(self, records: Iterable[Record]) -> None:
        """Add records, marked with the commit of the code, and flush."""
        with self.path.open("a", encoding="utf-8") as file:
            for record in records:
                file.write(json.dumps(_plain(replace(record, commit=commit()))) + "\n")
            file.flush()


@lru_cache(maxsize=1)
def commit() -> str:
    """Return the commit of this code, with "+" if files differ from it; "unknown" without git."""
    here = Path(__file__).resolve().parent
    try:
        ran = subprocess.run(
            ("git", "-C", str(here), "describe", "--always", "--dirty=+", "--exclude=*"),
            capture_output=True,
            text=True,
            check=False,
            timeout=30.0,
        )
    except OSError:
        return "unknown"
    return ran.stdout.strip() or "unknown"


def _plain(record: Record) -> dict[str, Any]:
    key = record.key
    return {
        "level": key.level,
        "case": key.case,
        "sensors": key.sensors,
        "method": key.method,
        "seed": key.seed,
        "status": record.status,
        "iterations": record.iterations,
        "nees": record.nees if np.isfinite(record.nees) else None,
        "bias_note": record.bias_note,
        "commit": record.commit,
        "error": _list(record.error),
        "sigma": _list(record.sigma),
    }


def _record(line: dict[str, Any]) -> Record:
    names = ("level", "case", "sensors", "method", "seed")
    return Record(
        key=Key(**{name: line[name] for name in names}),
        status=line["status"],
        error=_array(line["error"]),
        sigma=_array(line["sigma"]),
        nees=float("inf") if line["nees"] is None else float(line["nees"]),
        iterations=line["iterations"],
        bias_note=line["bias_note"],
        commit=line["commit"],
    )


def _list(values: FloatArray | None) -> list[float] | None:
    return None if values is None else [float(x) for x in values]


def _array(values: list[float] | None) -> FloatArray | None:
    return None if values is None else np.array(values)
