"""`hil lies`: how many valid outputs are wrong while a sensor lies slowly."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evidence import runner
from evidence.lies import DEFAULT, EXACT, KINDS, SENSORS
from evidence.lies.case import FLIGHTS, Case, work
from evidence.lies.table import every
from evidence.provenance import draw
from evidence.store import Row, Store
from evidence.terminal import print_table

SCENARIOS = ("target_leo", "base", "both")
TUMBLING = "tumbling_target"  # whose estimate needs the star tracker
MOST_WRONG: Mapping[str, float] = {DEFAULT: 0.0, EXACT: 0.02}  # of the valid outputs
LEAST_CAUGHT = 0.9  # of the harmful lies: no valid output is wrong
NOTE = (
    "wrong: valid and beyond 5 of its own sigmas; harmful: beyond 5 sigmas of the same flight "
    "without the lie; caught: harmful, and no output wrong"
)


def run(
    *, only: list[str], every: int, seed: int | None, jobs: int, out: Path | None, as_json: bool
) -> int:
    """Run the lies that the folder lacks; print how many outputs are wrong.

    Raises
    ------
    ScenarioError if the code has no commit of its own, or the folder holds another draw.
    """
    own = draw(seed)
    chosen = cases(own, only)[::every]
    store = Store(out, {"lies": "slow", "draw": own})
    rows = runner.rows("lies", work, chosen, store, jobs)
    found = summary(rows)
    if as_json:
        print(json.dumps(found))
    else:
        show(found)
    return int(not found["passed"])


def cases(draw: str, only: Sequence[str] = ()) -> list[Case]:
    """Return the cases in an order in which neighbours share a flight."""
    made = []
    for number, (sensor, kind, level) in enumerate(every()):
        name = TUMBLING if sensor == "tracker" else SCENARIOS[number % len(SCENARIOS)]
        flight = number // len(SCENARIOS) % FLIGHTS
        made += [
            Case(
                scenario=name,
                doubts=doubts,
                flight=flight,
                sensor=sensor,
                kind=kind,
                level=level,
                draw=draw,
            )
            for doubts in (EXACT, DEFAULT)
        ]
    return sorted(one for one in made if _is_chosen(one, only))


def _is_chosen(case: Case, only: Sequence[str]) -> bool:
    """Return whether a case has what is asked for of each of sensor, kind and doubt."""
    own = ((case.sensor, SENSORS), (case.kind, KINDS), (case.doubts, (EXACT, DEFAULT)))
    asked = [(value, [name for name in only if name in names]) for value, names in own]
    return all(value in names or not names for value, names in asked)


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the counts by doubt and sensor, and whether they are within their bounds."""
    found = {
        doubts: {
            name: _counts([row for row in rows if row["doubts"] == doubts and _is_of(row, name)])
            for name in ("all", *SENSORS, *KINDS)
        }
        for doubts in (EXACT, DEFAULT)
    }
    whole = {doubts: own["all"] for doubts, own in found.items()}
    harmful = sum(own["harmful"] for own in whole.values())
    caught = sum(own["caught"] for own in whole.values())
    flown = {(row["scenario"], row["doubts"], row["seed"]): row for row in rows}.values()
    within = all(own["wrong"] <= MOST_WRONG[doubts] * own["valid"] for doubts, own in whole.items())
    return {
        "lies": len(rows),
        "counts": found,
        "passed": within and caught >= LEAST_CAUGHT * harmful,
        "clean": {
            "outputs": sum(row["twin_valid"] + row["twin_lost"] for row in flown),
            "refused": sum(row["twin_refused"] for row in flown),
            "wrong": sum(row["twin_wrong"] for row in flown),
            "flights": len(flown),
        },
        "missed": [row for row in rows if row["wrong"]],
    }


def _is_of(row: Row, name: str) -> bool:
    return name in ("all", row["sensor"], row["kind"])


def _counts(rows: Sequence[Row]) -> dict[str, int]:
    harmful = [row for row in rows if row["harmful"] or row["wrong"]]
    return {
        "lies": len(rows),
        "valid": sum(row["valid"] for row in rows),
        "wrong": sum(row["wrong"] for row in rows),
        "harmful": len(harmful),
        "caught": sum(not row["wrong"] for row in harmful),
    }


def show(found: Mapping[str, Any]) -> None:
    """Print the table, the clean flights, and the lies with a wrong output."""
    print_table(
        f"{found['lies']} slow lies",
        ("declared", "of", "lies", "valid outputs", "wrong", "harmful", "caught"),
        [
            [doubts, name, *(str(value) for value in own.values())]
            for doubts, parts in found["counts"].items()
            for name, own in parts.items()
            if own["lies"]
        ],
        100,
        NOTE,
        "{flights} flights without a lie: of {outputs} outputs since the first valid one, "
        "{refused} refused by a false alarm, {wrong} wrong".format(**found["clean"]),
    )
    for row in found["missed"]:
        print(
            f"{row['doubts']} {row['scenario']} seed {row['seed']}: {row['lie']}: {row['wrong']} "
            f"of {row['valid']} wrong, worst {row['worst']:.1f} sigma"
        )
