"""A soak: epochs in turn, resumable from one to the next, and what they say together."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.stats import chi2

from fsw.config import load as load_config
from hil.bench import Setup, prepare
from hil.flight import write_yaml
from hil.scenario import at_rates, load
from hil.soak.epoch import REST_S, TAIL_S, Epoch, Segment

SCENARIO = "target_leo"
EPOCHS = 4
PART_S = 600.0
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
    hours: float, rate_hz: float, imu_rate_hz: int, seed: int, folder: Path
) -> Iterator[Segment]:
    """Yield segments; epochs that are whole in the folder are not flown again."""
    folder.mkdir(parents=True, exist_ok=True)
    scenario = at_rates(load(SCENARIO), rate_hz, imu_rate_hz)
    setup = prepare(scenario, seed, folder)
    document = yaml.safe_load(setup.config_path.read_text(encoding="utf-8"))
    document["recorder"]["part_s"] = PART_S
    write_yaml(setup.config_path, document)
    setup = prepare_again(setup)
    epochs, segments = plan(hours, setup.spline.duration_s)
    with ProcessPoolExecutor(1, get_context("spawn")) as reader:
        for number in range(epochs):
            path = folder / f"epoch_{number:03d}.json"
            if path.exists():
                continue
            place = folder / f"epoch_{number:03d}"
            shutil.rmtree(place, ignore_errors=True)
            flown = []
            for segment in Epoch(setup, seed, number, folder, reader).run(segments):
                flown.append(segment)
                yield segment
            temporary = path.with_suffix(".tmp")
            temporary.write_text(json.dumps([asdict(s) for s in flown]), encoding="utf-8")
            temporary.replace(path)
            shutil.rmtree(place)


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
