"""A soak: epochs in turn, resumable from one to the next, and what they say together."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, wait
from contextlib import suppress
from dataclasses import asdict, replace
from multiprocessing import get_context
from pathlib import Path
from queue import Empty, Queue
from typing import Any

import numpy as np
import yaml
from scipy.stats import chi2

from fsw.config import load as load_config
from hil.errors import same_settings
from hil.evidence.soak.epoch import REST_S, TAIL_S, Epoch, Segment
from hil.run.bench import Setup, prepare
from hil.run.flight import write_yaml
from hil.run.processes import end_with_interrupt
from hil.world.scenario import Scenario, at_rates, load
from hil.world.spline import JointSpline

SCENARIO = "target_leo"
EPOCHS = 4
PART_S = 600.0
POLL_S = 0.5
MOST_SLOPE_MB = 1.0  # of resident memory per 1e6 ticks, after warm-up
LEAST_TICKS = 300_000  # after warm-up; less says nothing about a slope
WARM_RATIO = 0.3
MB = 1e6


def plan(hours: float, motion_s: float) -> tuple[int, int]:
    """Return epochs and segments of each."""
    segments = max(1, round(hours * 3600.0 / (REST_S + motion_s + TAIL_S)))
    epochs = EPOCHS if segments >= 10 * EPOCHS else 1
    return epochs, -(-segments // epochs)


def soak(
    hours: float, rate_hz: float, imu_rate_hz: int, seed: int, folder: Path, jobs: int = 1
) -> Iterator[Segment]:
    """Yield segments as they are flown; every epoch has a process of its own, `jobs` at a time.

    Epochs that are whole in the folder are not flown again.

    Raises
    ------
    ScenarioError for a folder of a soak with other settings.
    """
    settings = {"hours": hours, "rate_hz": rate_hz, "imu_rate_hz": imu_rate_hz, "seed": seed}
    same_settings(folder, settings)
    scenario = at_rates(load(SCENARIO), rate_hz, imu_rate_hz)
    epochs, segments = plan(hours, JointSpline.load(scenario.identification).duration_s)
    todo = [number for number in range(epochs) if not _result(folder, number).exists()]
    if not todo:
        return
    context = get_context("spawn")
    with (
        context.Manager() as manager,
        ProcessPoolExecutor(jobs, context, end_with_interrupt, max_tasks_per_child=1) as pool,
    ):
        flown = manager.Queue()
        left = {pool.submit(fly, scenario, seed, n, segments, folder, flown) for n in todo}
        while left or not flown.empty():
            with suppress(Empty):
                yield flown.get(timeout=POLL_S)
            done, left = wait(left, timeout=0.0)
            for flight in done:
                flight.result()


def fly(
    scenario: Scenario, seed: int, number: int, segments: int, folder: Path, flown: Queue[Segment]
) -> None:
    """Fly one epoch; put its segments in the queue, and all of them in a file when it is whole."""
    place = folder / f"epoch_{number:03d}"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    setup = prepare(scenario, seed, place)
    document = yaml.safe_load(setup.config_path.read_text(encoding="utf-8"))
    document["recorder"]["part_s"] = PART_S
    write_yaml(setup.config_path, document)
    results = []
    with ProcessPoolExecutor(1, get_context("spawn"), end_with_interrupt) as reader:
        epoch = Epoch(prepare_again(setup), seed, number, place, reader)
        for segment in epoch.run(segments):
            results.append(asdict(segment))
            flown.put(segment)
    path = _result(folder, number)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps(results), encoding="utf-8")
    temporary.replace(path)
    shutil.rmtree(place)


def _result(folder: Path, number: int) -> Path:
    return folder / f"epoch_{number:03d}.json"


def prepare_again(setup: Setup) -> Setup:
    """Return the setup with its configuration read anew."""
    return replace(setup, config=load_config(setup.config_path))


def slope_mb(segments: list[dict[str, Any]]) -> tuple[float, int]:
    """Return the growth of resident memory per 1e6 ticks after warm-up [MB], and over how many."""
    warm = segments[int(WARM_RATIO * len(segments)) :]
    ticks = np.array([s["ticks"] for s in warm], dtype=np.float64)
    memory = np.array([s["resident_bytes"] for s in warm], dtype=np.float64)
    span = int(ticks[-1] - ticks[0]) if len(warm) > 2 else 0
    return (float(np.polyfit(ticks / 1e6, memory / MB, 1)[0]) if span else 0.0), span


def summary(folder: Path) -> dict[str, Any]:
    """Judge what is in the folder."""
    epochs = [json.loads(p.read_text()) for p in sorted(folder.glob("epoch_*.json"))]
    segments = [segment for epoch in epochs for segment in epoch]
    slopes = [slope_mb(epoch) for epoch in epochs]
    nees = np.array([s["nees"] for s in segments])
    dof, count = 10, len(segments)
    low, high = (float(chi2.ppf(p, dof * count)) / count for p in (0.005, 0.995))
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
