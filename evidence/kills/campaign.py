"""Run many kills in many rounds, resume after an interruption, and summarise the kills."""

import shutil
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from evidence.kills.round import BOUND_RATIO, VICTIMS, Kill, Round
from evidence.store import Store

PER_ROUND = 12  # most kills in a round, which is one motion of about a minute


def campaign(count: int, folder: Path, seed: int) -> Iterator[Kill]:
    """Yield new kills until the folder has `count`; keep the files of a round with faults.

    Raises
    ------
    LiveError if a daemon does not return; the round's files are kept. ScenarioError if the folder
    has kills of another seed.
    """
    store = Store(folder, {"seed": seed})
    number = 1 + max((kill["round"] for kill in store.rows.values()), default=-1)
    while len(store.rows) < count:
        place = folder / f"round_{number:03d}"
        if place.exists():
            shutil.rmtree(place)
        place.mkdir()
        faulty = False
        for kill in Round(place, number, seed).run(min(PER_ROUND, count - len(store.rows))):
            store.add(f"{kill.round}-{kill.number}", asdict(kill))
            faulty |= bool(kill.faults)
            yield kill
        if not faulty:
            shutil.rmtree(place)
        number += 1


def summary(folder: Path, seed: int) -> dict[str, Any]:
    """Return the counts, the worst times, and every fault of the kills in a folder."""
    held = list(Store(folder, {"seed": seed}).rows.values())
    result: dict[str, Any] = {"kills": len(held), "bound_ratio": BOUND_RATIO}
    for victim in VICTIMS:
        ratios = [kill["ratio"] for kill in held if kill["victim"] == victim]
        if ratios:
            result[victim] = {
                "kills": len(ratios),
                "median_ratio": float(np.median(ratios)),
                "worst_ratio": max(ratios),
            }
    result["most_lost_s"] = max((kill["lost_s"] for kill in held), default=0.0)
    result["faults"] = [
        {"round": kill["round"], "number": kill["number"], "faults": kill["faults"]}
        for kill in held
        if kill["faults"]
    ]
    result["late"] = sum(bool(kill["late"]) for kill in held)
    return result
