"""The fault matrix as a table on the terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table as Grid

from evidence.fault_matrix.table import Table


def show(outcomes: Sequence[Mapping[str, Any]], table: Table, seed: int, console: Console) -> None:
    """Print a line for each fault, the bounds, the clean runs, and the reasons for wide bounds."""
    rows = {row.type: row for row in table.faults}
    lane = f"seed {seed}, {table.total_s - table.before_s:g} s of motion"
    grid = Grid(title=f"Fault matrix, {lane}", title_justify="left")
    for name in (
        "fault",
        "event",
        "told after ms",
        "bound",
        "over after s",
        "bound",
        "NEES",
        "sigma",
        "",
    ):
        grid.add_column(name, justify="left" if name in ("fault", "event", "") else "right")
    for values in outcomes:
        row = rows[values["type"]]
        verdict = "ok" if not values["failed"] else "FAILED: " + ", ".join(values["failed"])
        if values["others"]:
            verdict += f" ({', '.join(values['others'])})"
        grid.add_row(
            values["type"],
            values["event"] + _mark(row.shares),
            _number(values["detect_s"], 1e3, ".1f"),
            f"{1e3 * values['detect_bound_s']:.0f}{_mark(row.reason)}",
            _number(values["recover_s"], 1.0, ".2f"),
            f"{values['recover_bound_s']:g}{_mark(row.recover_reason)}",
            _number(values["nees"], 1.0, ".1f"),
            _number(values["sigma_ratio"], 1.0, ".3f"),
            verdict,
        )
    console.print(grid)
    console.print(
        f"Bounds: recovery {table.recover_bound_s:g} s (1 s and the filter's {table.filter_s:g} s);"
        f" NEES {outcomes[0]['nees_bound']:.1f} (chi-squared, {100 * table.probability:g} %);"
        f" sigma {table.sigma_least:g}-{table.sigma_ratio:g} x that of the run lacking only the"
        " truly lost samples.",
        soft_wrap=True,
    )
    clean = {rows[v["type"]].lane: v["clean"] for v in outcomes if "clean" in v}
    for name, found in clean.items():
        told = ", ".join(found["codes"]) or "nothing"
        text = f"Without a fault, {name}: told {told}; NEES {found['nees']:.1f}."
        console.print(text, soft_wrap=True)
    shown = [rows[values["type"]] for values in outcomes]
    used = {reason for row in shown for reason in row.reasons if reason}
    for name in sorted(used):
        console.print(f"({name}) {table.reasons[name]}", soft_wrap=True)
    good = sum(not values["failed"] for values in outcomes)
    console.print(f"{good} of {len(outcomes)} within every bound")


def _number(value: float | None, factor: float, form: str) -> str:
    return "-" if value is None else format(factor * value, form)


def _mark(reason: str) -> str:
    return f" ({reason})" if reason else ""
