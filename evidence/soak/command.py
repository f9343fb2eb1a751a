"""`hil soak`: run the campaign, and print every broken invariant."""

import json
from pathlib import Path

from evidence.soak.campaign import SCENARIO, open_store, plan, soak, summary
from evidence.soak.epoch import SoakSegment
from evidence.terminal import bar
from hil.world.scenario import load
from hil.world.spline import JointSpline


def run(*, hours: float, rate: float, imu_rate: int, seed: int, jobs: int, out: Path) -> int:
    """Print what broke and the summary; return the exit code, 1 if anything broke."""
    chosen = (hours, rate, imu_rate, seed)
    folder = out.absolute()
    whole = len(open_store(folder, *chosen).rows)
    motion_s = JointSpline.load(load(SCENARIO).identification).duration_s
    epochs, segments = plan(hours, motion_s)
    with bar() as progress:
        task = progress.add_task("soak", total=epochs * segments, completed=whole * segments)

        def announce(segment: SoakSegment) -> None:
            progress.advance(task)
            for text in segment.broken:
                place = f"epoch {segment.epoch} segment {segment.number}"
                progress.console.print(f"{place}: {text}", markup=False)

        store = soak(*chosen, folder, jobs, announce)
    result = summary(store)
    print(json.dumps(result))
    return int(bool(result["broken"]))
