"""Write a collected replay as tables (CSV, Parquet)."""

import csv
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fsw.exchange.status import body_sigma, body_values
from offline.identified_body import QUANTITIES
from offline.parquet import write_parquet
from offline.report.collect import Collected


class Table(NamedTuple):
    """Column names, and a function that yields the rows; floats keep every digit."""

    head: list[str]
    rows: Callable[[], Iterator[list[Any]]]


def tables(collected: Collected) -> dict[str, Table]:
    """Return the tables `estimate`, `residuals` (missing without residuals) and `events`.

    Times are seconds from the start of the replayed part.
    """
    start_ns = collected.result.start_ns

    def seconds(t_ns: int) -> float:
        return round((t_ns - start_ns) * 1e-9, 6)

    bodies = [f"{body}_{name}" for body in collected.result.unknown for name in QUANTITIES]
    head = ["t_s", "valid", "reason", "nis", "nis_dof"]
    head += [*bodies, *(f"{name}_sigma" for name in bodies)]

    def estimates() -> Iterator[list[Any]]:
        for e in collected.estimates:
            own = [seconds(e.t_ns), int(e.valid), ", ".join(e.reasons), e.nis, e.nis_dof]
            own += [x for b in e.bodies.values() for x in _flat(body_values(b).values())]
            yield own + [x for b in e.bodies.values() for x in _flat(body_sigma(b).values())]

    def events() -> Iterator[list[Any]]:
        for e in collected.events:
            yield [seconds(e.t_ns), e.severity, e.code, e.text]

    found = {"estimate": Table(head, estimates)}
    r = collected.residuals
    if r is not None:
        units = [f"{n} [{u}]" for n, u in zip(r.names, r.units, strict=True)]
        head = ["t_s", *units, *(f"{name} sigma" for name in units)]

        def residuals() -> Iterator[list[Any]]:
            for t_ns, value, sigma in zip(r.t_ns, r.value, r.sigma, strict=True):
                yield [seconds(int(t_ns)), *value.tolist(), *sigma.tolist()]

        found["residuals"] = Table(head, residuals)
    return found | {"events": Table(["t_s", "severity", "code", "text"], events)}


def _flat(values: Iterable[object]) -> list[float]:
    return [float(x) for value in values for x in np.atleast_1d(np.asarray(value))]


def write_tables(collected: Collected, stem: Path, kinds: Collection[str]) -> list[Path]:
    """Write each table as STEM_NAME.KIND for each of `kinds` (csv, parquet); return the paths.

    Raises
    ------
    ConfigError if pyarrow is needed and missing; OSError when a file cannot be written.
    """
    written = []
    for name, table in tables(collected).items() if kinds else ():
        for kind in kinds:
            written.append(stem.with_name(f"{stem.name}_{name}.{kind}"))
            if kind == "csv":
                write_csv(table, written[-1])
            else:
                columns = list(zip(*table.rows(), strict=True)) or [()] * len(table.head)
                write_parquet(written[-1], dict(zip(table.head, columns, strict=True)))
    return written


def write_csv(table: Table, path: Path) -> None:
    """Write a table as CSV with a line of column names. Raises OSError."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(table.head)
        writer.writerows(table.rows())
