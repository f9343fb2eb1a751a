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
    own = {k: v for k, v in asdict(record).items() if k != "key"}
    lists = {k: None if own[k] is None else own[k].tolist() for k in ("error", "sigma")}
    nees = record.nees if np.isfinite(record.nees) else None
    return asdict(record.key) | own | lists | {"nees": nees}


def _record(row: Row) -> StudyRecord:
    key = {name: row[name] for name in Key.__slots__}
    own = {name: row[name] for name in StudyRecord.__slots__ if name != "key"}
    own |= {k: None if own[k] is None else np.array(own[k]) for k in ("error", "sigma")}
    own["nees"] = float("inf") if own["nees"] is None else float(own["nees"])
    return StudyRecord(key=Key(**key), **own)
