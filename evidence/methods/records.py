"""Records of the study as rows of its store.

Each row has the commit of the code that made it, because methods may change during a study.
"""

from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from evidence.methods.cases import Key, StudyRecord, settings
from evidence.provenance import commit
from evidence.store import Row, Store
from hil.world.inertia import FloatArray


def open_store(folder: Path) -> Store:
    """Return the store of the study in a folder. Raises ScenarioError if it has other settings."""
    return Store(folder, settings())


def name(key: Key) -> str:
    """Return the key of a record's row in the store."""
    return "|".join((key.level, key.case, key.sensors, key.method, str(key.seed)))


def records(store: Store) -> dict[Key, StudyRecord]:
    """Return all stored records by key."""
    found = map(_record, store.rows.values())
    return {record.key: record for record in found}


def rows(results: Iterable[StudyRecord]) -> dict[str, Row]:
    """Return the rows of records by the key in the store, with the commit of the present code."""
    return {name(record.key): _plain(replace(record, commit=commit())) for record in results}


def _plain(record: StudyRecord) -> Row:
    return {
        **asdict(record.key),
        "status": record.status,
        "iterations": record.iterations,
        "nees": record.nees if np.isfinite(record.nees) else None,
        "bias_note": record.bias_note,
        "commit": record.commit,
        "error": _list(record.error),
        "sigma": _list(record.sigma),
    }


def _record(row: Row) -> StudyRecord:
    names = ("level", "case", "sensors", "method", "seed")
    return StudyRecord(
        key=Key(**{name: row[name] for name in names}),
        status=row["status"],
        error=_array(row["error"]),
        sigma=_array(row["sigma"]),
        nees=float("inf") if row["nees"] is None else float(row["nees"]),
        iterations=row["iterations"],
        bias_note=row["bias_note"],
        commit=row["commit"],
    )


def _list(values: FloatArray | None) -> list[float] | None:
    return None if values is None else [float(x) for x in values]


def _array(values: list[float] | None) -> FloatArray | None:
    return None if values is None else np.array(values)
