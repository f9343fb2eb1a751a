"""A soak: run epochs, continue with the missing epochs after an interruption, summarise them."""

import hashlib
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from multiprocessing.managers import SyncManager
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import Any

import numpy as np
import yaml

from evidence import pool, runner
from evidence.soak.epoch import REST_S, TAIL_S, SoakEpoch, SoakSegment
from evidence.store import Row, Store
from fsw.config import load as load_config
from hil.judge import chi_square
from hil.run.bench import Setup, prepare
from hil.run.flight import write_yaml
from hil.run.processes import end_with_driver
from hil.world.scenario import Scenario, at_rates, load
from hil.world.spline import JointSpline

SCENARIO = "target_leo"
EPOCHS = 4
PART_S = 600.0  # duration of one file of a recording
MOST_SLOPE_MB = 1.0  # largest growth of resident memory per 1e6 ticks, after warm-up
LEAST_TICKS = 300_000  # after warm-up; a slope over fewer ticks is not judged
WARM_RATIO = 0.3  # share of the segments that are the warm-up
MB = 1e6


def plan(hours: float, motion_s: float) -> tuple[int, int]:
    """Return the number of epochs and the number of segments in each epoch."""
    segments = max(1, round(hours * 3600.0 / (REST_S + motion_s + TAIL_S)))
    epochs = EPOCHS if segments >= 10 * EPOCHS else 1
    return epochs, -(-segments // epochs)


@dataclass(frozen=True, slots=True, kw_only=True)
class SoakCase:
    """One epoch, and the queue that gets each of its segments when the segment ends."""

    scenario: Scenario
    seed: int
    number: int
    segments: int
    folder: Path
    flown: Queue[SoakSegment | None]


def open_store(folder: Path, hours: float, rate_hz: float, imu_rate_hz: int, seed: int) -> Store:
    """Return the store of a soak. Raises ScenarioError if the folder has other settings."""
    settings = {"hours": hours, "rate_hz": rate_hz, "imu_rate_hz": imu_rate_hz, "seed": seed}
    return Store(folder, settings)


def soak(
    hours: float,
    rate_hz: float,
    imu_rate_hz: int,
    seed: int,
    folder: Path,
    jobs: int = 1,
    announce: Callable[[SoakSegment], None] = lambda _: None,
) -> Store:
    """Run the epochs that the folder lacks, each in a separate process; return the folder's store.

    A thread calls `announce` with each segment when the segment ends. `jobs` epochs run at a time.

    Raises
    ------
    ScenarioError if the folder has a soak with other settings.
    """
    store = open_store(folder, hours, rate_hz, imu_rate_hz, seed)
    scenario = at_rates(load(SCENARIO), rate_hz, imu_rate_hz)
    epochs, segments = plan(hours, JointSpline.load(scenario.identification).duration_s)
    todo = runner.missing(range(epochs), str, store)
    if not todo:
        return store
    with _announced(announce) as flown:
        cases = [
            SoakCase(
                scenario=scenario,
                seed=seed,
                number=number,
                segments=segments,
                folder=folder,
                flown=flown,
            )
            for number in todo
        ]
        for _ in runner.stored(pool.over_processes(fly, cases, jobs, single=True), store):
            pass
    return store


@contextmanager
def _announced(announce: Callable[[SoakSegment], None]) -> Iterator[Queue[SoakSegment | None]]:
    """Yield a queue for other processes; a thread announces the segments in the queue."""
    manager = SyncManager(ctx=get_context("spawn"))
    manager.start(end_with_driver)
    flown: Queue[SoakSegment | None] = manager.Queue()

    def follow() -> None:
        while (segment := flown.get()) is not None:
            announce(segment)

    with manager:
        thread = Thread(target=follow, daemon=True)
        thread.start()
        try:
            yield flown
        finally:
            flown.put(None)
            thread.join()


def fly(case: SoakCase) -> dict[str, Row]:
    """Run one epoch and announce its segments; return its row under its number."""
    place = case.folder / f"epoch_{case.number:03d}"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    setup = prepare(case.scenario, case.seed, place)
    document = yaml.safe_load(setup.config_path.read_text(encoding="utf-8"))
    document["recorder"]["part_s"] = PART_S
    write_yaml(setup.config_path, document)
    segments = []
    with ProcessPoolExecutor(1, get_context("spawn"), end_with_driver) as reader:
        epoch = SoakEpoch(prepare_again(setup), case.seed, case.number, place, reader)
        for segment in epoch.run(case.segments):
            segments.append(asdict(segment))
            case.flown.put(segment)
    shutil.rmtree(place)
    return {str(case.number): {"segments": segments}}


def prepare_again(setup: Setup) -> Setup:
    """Return the set-up with its configuration loaded again from the file."""
    return replace(setup, config=load_config(setup.config_path))


def slope_mb(segments: list[dict[str, Any]]) -> tuple[float, int]:
    """Return the growth of memory per 1e6 ticks after warm-up [MB], and the number of ticks."""
    warm = segments[int(WARM_RATIO * len(segments)) :]
    ticks = np.array([s["ticks"] for s in warm], dtype=np.float64)
    memory = np.array([s["resident_bytes"] for s in warm], dtype=np.float64)
    span = int(ticks[-1] - ticks[0]) if len(warm) > 2 else 0
    return (float(np.polyfit(ticks / 1e6, memory / MB, 1)[0]) if span else 0.0), span


def summary(store: Store) -> dict[str, Any]:
    """Return the figures over all epochs in the store, and the broken invariants."""
    epochs = [store.rows[key]["segments"] for key in sorted(store.rows, key=int)]
    segments = [segment for epoch in epochs for segment in epoch]
    slopes = [slope_mb(epoch) for epoch in epochs]
    nees = np.array([s["nees"] for s in segments])
    dof, count = 10, len(segments)
    low, high = chi_square.mean_ends(dof, count, 0.01)
    mean = float(np.mean(nees))
    digest = hashlib.sha256("".join(epoch[-1]["digest"] for epoch in epochs).encode()).hexdigest()
    broken = [text for s in segments for text in s["broken"]]
    broken += [
        f"epoch {k}: resident memory grows {slope:.2f} MB per 1e6 ticks"
        for k, (slope, span) in enumerate(slopes)
        if span >= LEAST_TICKS and slope >= MOST_SLOPE_MB
    ]
    if not low <= mean <= high:
        broken.append(f"mean NEES {mean:.2f} outside [{low:.2f}, {high:.2f}]")
    return {
        "segments": count,
        "valid": sum(s["valid"] for s in segments),
        "ticks": sum(epoch[-1]["ticks"] for epoch in epochs),
        "slips": sum(epoch[-1]["slips"] for epoch in epochs),
        "slips_injected": sum(epoch[-1]["injected"] for epoch in epochs),
        "mean_nees": mean,
        "nees_band_99": [low, high],
        "memory_slope_mb_per_1e6_ticks": [slope for slope, _ in slopes],
        "slope_over_ticks": [span for _, span in slopes],
        "sha256": digest,
        "broken": broken,
    }
