"""`hil alarms`: how often each check fails a clean flight, beside the rate it states."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scipy.stats import beta

from evidence import runner
from evidence.alarms.case import BYTES, SAMPLES, Case, work
from evidence.provenance import draw
from evidence.store import Row, Store
from evidence.terminal import print_table
from fsw.messages.false_alarms import FLIGHT_RATE, SHARES, rate

SCENARIOS = (
    *("target_leo", "base", "both", "panel_leo", "base_slosh", "wheels_leo"),
    *("mev", "dual_arm", "tumbling_target"),
)
STATED: Mapping[str, float] = {
    **{check: rate(check) for check in ("gate", "outside", "change", "sensor", "prior", "creep")},
    **{check: SHARES[check] for check in ("level", "consistency", "sample", "pace")},
    "mismatch": sum(SHARES[check] for check in ("slow", "colour", "drift")),
    "reset": 0.0,
}
CONFIDENCE = 0.95
ANY = "invalid at the end"
NOTE = "flights that do not show a check are not counted for it; outside: only where it is watched"


def run(
    *,
    scenario: list[str],
    samples: int,
    from_bytes: int,
    jobs: int,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fly the flights that the folder lacks and print how often each check fired.

    Raises
    ------
    ScenarioError if the code has no commit of its own, or the folder holds another one's flights.
    """
    own = draw(None)
    cases = [
        Case(level, name, number, own)
        for level, flights in ((SAMPLES, samples), (BYTES, from_bytes))
        for name in scenario or SCENARIOS
        for number in range(flights)
    ]
    store = Store(out, {"alarms": "clean flights", "commit": own})
    rows = runner.rows("alarms", work, cases, store, jobs)
    found = summary(rows)
    if as_json:
        print(json.dumps(found))
    else:
        show(found)
    return int(any(line["beyond"] for line in found["checks"].values()))


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Return how many flights each check failed, and with which rate that agrees.

    A flight from samples does not show samples left out, one from bytes no sensor left out.
    """
    seen = {check: [r["fired"][check] for r in rows if check in r["fired"]] for check in STATED}
    seen[ANY] = [not row["valid"] for row in rows]
    return {
        "flights": {
            level: {
                name: sum(r["level"] == level and r["scenario"] == name for r in rows)
                for name in sorted({row["scenario"] for row in rows})
            }
            for level in (SAMPLES, BYTES)
        },
        "wrong": sum(row["wrong"] > 0 for row in rows),
        "checks": {
            check: line(sum(map(bool, fired)), len(fired), STATED.get(check, FLIGHT_RATE))
            for check, fired in seen.items()
        },
        "failed": [
            {key: row[key] for key in ("level", "scenario", "seed", "reason", "fired")}
            for row in rows
            if not row["valid"] or any(row["fired"].values())
        ],
    }


def line(failed: int, flights: int, stated: float) -> dict[str, Any]:
    """Return the exact interval of a rate (Clopper, Pearson), and whether it excludes `stated`."""
    low = float(beta.ppf(1.0 - CONFIDENCE, failed, flights - failed + 1)) if failed else 0.0
    high = 1.0 if failed == flights else float(beta.ppf(CONFIDENCE, failed + 1, flights - failed))
    return {
        "failed": failed,
        "flights": flights,
        "low": low,
        "high": high,
        "stated": stated,
        "beyond": low > stated,
    }


def show(found: Mapping[str, Any]) -> None:
    """Print the table and the flights in which a check fired."""
    total = sum(n for own in found["flights"].values() for n in own.values())
    print_table(
        f"checks that fired in {total} clean flights",
        ("check", "flights failed", "one-sided 95 % bound", "stated rate", ""),
        [
            [
                *(check, f"{own['failed']} of {own['flights']}", f"{own['high']:.1e}"),
                *(f"{own['stated']:.1e}", "FAILED" if own["beyond"] else "ok"),
            ]
            for check, own in found["checks"].items()
        ],
        120,
        NOTE,
    )
    for flight in found["failed"]:
        print(json.dumps(flight))
