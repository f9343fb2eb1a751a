"""The outcome of a run on a terminal: bodies, tool error, consistency, samples, events."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.judge.score import bound_words, exact_words, nees_words, table, table_header

FULL_WIDTH = 108  # columns of a terminal that holds every column of the table
LEFT_OUT = ("prior", "bound", "raw OLS")  # columns that a narrower terminal does not show
MEANING = "bound: the Cramer-Rao sigma of all sensors; raw OLS: the paper's first method"
TOOL = ("mean_position_m", "max_position_m", "mean_angle_rad", "max_angle_rad")


def show(outcome: Mapping[str, Any], picture: Path | None, console: Console) -> None:
    """Print the outcome of a run."""
    for body in outcome["unknown"]:
        _body(outcome, body, console)
    _tool(outcome, console)
    for body, bias in outcome["ols"]["mass_error_ratio"].items() if outcome["ols"] else ():
        console.print(f"raw OLS on the same data: {body} mass {100 * bias:+.1f} %")
    state = "valid" if outcome["valid"] else f"not valid: {outcome['reason']}"
    console.print(f"{nees_words(outcome)}; {state}")
    for line in exact_words(outcome):
        console.print(line)
    validity = outcome["imu_time_of_validity"]
    if validity:
        console.print(f"IMU time of validity: {1e6 * validity['rms_s']:.1f} us rms after 5 s")
    for source, counters in outcome["samples"].items():
        console.print(f"{source}: " + ", ".join(f"{v} {k}" for k, v in counters.items()))
    stalls = outcome.get("bench_stalls") or {"count": 0, "explains": {}}
    explained = Counter(stalls["explains"])
    if found := Counter(outcome["events"]) - explained:
        console.print(f"events above info: {_counts(found)}; docs/faults.md has each")
    if stalls["count"]:
        console.print(
            f"bench stalled {stalls['count']} times, at most {1e3 * stalls['longest_s']:.0f} ms:"
            f" its devices were late; explains {_counts(explained) or 'no event'}; what came in"
            f" {stalls['covered_s']:.0f} s of the flight counts as explained"
        )
    console.print(
        f"{outcome['slips']} slips (ticks that this machine began a period or more late); "
        f"{outcome['simulated_s']:.0f} s in {outcome['wall_s']:.1f} s"
    )
    if picture is not None:
        console.print(f"page: {picture.with_suffix('.html')}\npicture: {picture}")


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {code}" for code, count in counts.items())


def _body(outcome: Mapping[str, Any], body: str, console: Console) -> None:
    head = table_header(outcome)
    narrow = console.width < FULL_WIDTH
    kept = [k for k, title in enumerate(head) if not (narrow and title in LEFT_OUT)]
    caption = f"{', '.join(LEFT_OUT)}: in a wider terminal and on the page" if narrow else MEANING
    shown = Table(title=f"{body}: inertia about the centre of mass, body frame", caption=caption)
    for k in kept:
        shown.add_column(head[k], justify="right" if head[k] else "left", no_wrap=True)
    for line in table(outcome, body):
        shown.add_row(*(line[k] for k in kept))
    console.print(shown)
    console.print(f"{body} mass sigma is {bound_words(outcome, body)}")


def _tool(outcome: Mapping[str, Any], console: Console) -> None:
    tool = Table(title="end-effector error on the verification trajectory")
    for title in ("", "mean [mm]", "max [mm]", "mean [mrad]", "max [mrad]"):
        tool.add_column(title, justify="right" if title else "left")
    lines = {
        "prior": outcome["ee_error_prior"],
        "estimate": outcome["ee_error"],
        "expected from the covariance": outcome["ee_error_expected"],
    }
    if outcome["ols"]:
        lines["raw OLS (the paper's MRNEA)"] = outcome["ols"]["ee_error"]
    for name, error in lines.items():
        tool.add_row(name, *(f"{1e3 * error[key]:.4g}" for key in TOOL))
    console.print(tool)
