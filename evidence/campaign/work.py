"""One run of a campaign; its results depend on the values of `CampaignRun` only."""

import hashlib
import tempfile
import time
import traceback
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from evidence.campaign.config import CampaignRun
from evidence.methods import exact
from evidence.methods.cases import SENSOR_SETS, WIDER
from evidence.methods.flight_side import without_biases, write_config
from evidence.methods.methods import FUSED, on_blocks
from evidence.methods.sensed import condition, declared, draws, sensed, with_noise
from evidence.store import Row
from hil.judge.endeffector import Verification
from hil.judge.score import normalised_error_squared
from hil.run.bench import prepare, run_virtual
from hil.run.progress import Quiet
from hil.world.history import TruthState
from hil.world.inertia import FloatArray, pi_of
from hil.world.scenario import Scenario, load
from hil.world.simulation import simulate_in
from hil.world.spline import JointSpline

NOISE_STREAM = 211
STEP_S = 0.01


def rows_of(run: CampaignRun) -> dict[str, Row]:
    """Return the row of a run under its key; the row of a failed run has the traceback."""
    began_s = time.perf_counter()
    row = _named(run)
    try:
        row |= _sample(run) if run.level == "sample" else _device(run)
    except Exception:  # noqa: BLE001  every error belongs in the row of the run
        row |= {"status": "FAILED", "traceback": traceback.format_exc()}
    return {run.key: row | {"wall_s": time.perf_counter() - began_s}}


def rows_of_lost(run: CampaignRun, reason: str) -> dict[str, Row]:
    """Return the row of a run of which every attempt failed; `reason` is its traceback."""
    return {run.key: _named(run) | {"status": "FAILED", "traceback": reason, "wall_s": 0.0}}


def _named(run: CampaignRun) -> dict[str, Any]:
    return {
        "key": run.key,
        "seed": run.seed,
        "scenario": run.scenario,
        "noise": run.noise,
        "trajectory": "" if run.trajectory is None else str(run.trajectory),
        "status": "",
        "traceback": "",
    }


def _sample(run: CampaignRun) -> dict[str, Any]:
    scenario, noise = scenario_of(run.scenario, run.trajectory), SENSOR_SETS[run.noise]
    state = _exact(run.scenario, run.trajectory, run.duration_s, run.rate_hz)
    rng = np.random.default_rng(np.random.SeedSequence(run.seed, spawn_key=(NOISE_STREAM,)))
    unit = draws(len(state.q), state.q.shape[1], rng, shared=noise.shared)
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder:
        told = without_biases(replace(scenario, environment=None))
        config = declared(write_config(told, run.seed, Path(folder), WIDER), noise, run.rate_hz)
        channels = with_noise(sensed(state, config), noise, unit)
        found = on_blocks(FUSED, condition(channels, config, run.rate_hz), config)
    return _judged(run, scenario, found.x, found.covariance, found.status)


def _device(run: CampaignRun) -> dict[str, Any]:
    scenario = scenario_of(run.scenario, run.trajectory)
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder:
        setup = prepare(scenario, run.seed, Path(folder))
        if run.duration_s is not None:
            rest_s = setup.spline.duration_s + scenario.after_s - run.duration_s
            shorter = replace(scenario, after_s=scenario.after_s - rest_s)
            setup = replace(setup, scenario=shorter)
        final = run_virtual(setup, Quiet(), record=False).final
    k = slice(0, 10 * len(scenario.unknown))
    covariance = np.array(final.covariance[k, k])
    status = "OK" if final.valid else final.reason
    return _judged(run, scenario, final.x[k], covariance, status)


def _judged(
    run: CampaignRun, scenario: Scenario, x: FloatArray, covariance: FloatArray, status: str
) -> dict[str, Any]:
    truth = np.concatenate([pi_of(scenario.truth[body]) for body in scenario.unknown])
    tool = verification(run.scenario, run.trajectory).error(x, truth).summary()
    whole = np.concatenate([x, np.ascontiguousarray(covariance).ravel()])
    return {
        "status": status,
        "error": (x - truth).tolist(),
        "sigma": np.sqrt(np.diag(covariance)).tolist(),
        "bound": np.sqrt(np.diag(covariance)).tolist(),
        "nees": normalised_error_squared(x - truth, covariance),
        "digest": hashlib.sha256(whole.astype("<f8").tobytes()).hexdigest(),
        **tool,
    }


@lru_cache(maxsize=8)
def scenario_of(name: str, trajectory: Path | None) -> Scenario:
    """Return a scenario; a given trajectory replaces its identification motion."""
    scenario = load(name)
    return scenario if trajectory is None else replace(scenario, identification=trajectory)


@lru_cache(maxsize=8)
def verification(name: str, trajectory: Path | None) -> Verification:
    """Return the verification of a scenario: the motion on which the tool's error is predicted."""
    return exact.verification(scenario_of(name, trajectory))


@lru_cache(maxsize=8)
def _exact(
    name: str, trajectory: Path | None, duration_s: float | None, rate_hz: float
) -> TruthState:
    scenario = scenario_of(name, trajectory)
    spline = JointSpline.load(scenario.identification)
    end_s = min(duration_s or spline.duration_s, spline.duration_s)
    robot = exact.true_robot(scenario)
    history = simulate_in(scenario.environment, robot, spline, 0.0, end_s + STEP_S, STEP_S)
    return history.at(np.arange(round(end_s * rate_hz)) / rate_hz)
