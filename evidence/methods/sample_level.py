"""Sample level: exact samples with white noise, the flight conditioner, and every method."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evidence.methods.cases import (
    NODES,
    RATE_HZ,
    SAMPLE,
    SENSOR_SETS,
    WIDER,
    WINDOW_S,
    Key,
    StudyRecord,
    scenario_of,
    truth_of,
)
from evidence.methods.exact import exact_samples
from evidence.methods.flight_side import without_biases, write_config
from evidence.methods.methods import MethodOutcome, on_blocks
from evidence.methods.sensed import condition, declared, draws, sensed, with_noise
from fsw.config import Config
from fsw.errors import EstimatorError
from fsw.messages import Block
from hil.judge.score import normalised_error_squared
from hil.world.inertia import FloatArray

NOISE_STREAM = 113  # spawn key of the samples' noise, independent of priors and devices


def run_seed(case: str, sensors: str, seed: int, methods: Sequence[str]) -> list[StudyRecord]:
    """Return the results of the methods on one draw of noise.

    A seed has the same unit noise for every case and sensor set. The seed also draws the prior, at
    which the iterations start.
    """
    noise, state = SENSOR_SETS[sensors], exact_samples(case)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(NOISE_STREAM,)))
    unit = draws(len(state.q), state.q.shape[1], rng, shared=noise.shared)
    with tempfile.TemporaryDirectory(prefix="study-") as folder:
        plain = without_biases(scenario_of(case))
        config = declared(
            write_config(plain, seed, Path(folder), WIDER),
            noise,
            RATE_HZ,
            window_s=WINDOW_S,
            nodes=NODES,
        )
        blocks = condition(with_noise(sensed(state, config), noise, unit), config, RATE_HZ)
        return judge_all(SAMPLE, case, sensors, seed, methods, blocks, config)


def judge_all(
    level: str,
    case: str,
    sensors: str,
    seed: int,
    methods: Sequence[str],
    blocks: Sequence[Block],
    config: Config,
) -> list[StudyRecord]:
    """Return the records of the methods on the same blocks; a failed method has a record too."""
    records = []
    for method in methods:
        key = Key(level=level, case=case, sensors=sensors, method=method, seed=seed)
        try:
            outcome = on_blocks(method, blocks, config)
        except (EstimatorError, np.linalg.LinAlgError) as error:
            records.append(failed(key, str(error)))
            continue
        records.append(judged(key, outcome, truth_of(case)))
    return records


def judged(key: Key, outcome: MethodOutcome, truth: FloatArray) -> StudyRecord:
    """Return the record of a result against the truth (10 b,); an invalid result is a failure."""
    error, covariance = outcome.x - truth, outcome.covariance
    if not (np.all(np.isfinite(error)) and np.all(np.isfinite(covariance))):
        return failed(key, f"{outcome.status}: not finite")
    variance = np.diag(covariance)
    if not np.all(variance > 0):
        return failed(key, f"{outcome.status}: covariance not positive")
    return StudyRecord(
        key=key,
        status=outcome.status,
        error=error,
        sigma=np.sqrt(variance),
        nees=normalised_error_squared(error, covariance),
        iterations=outcome.iterations,
        bias_note=outcome.bias_note,
    )


def failed(key: Key, reason: str) -> StudyRecord:
    """Return the record of a method that failed."""
    status = f"FAILED: {reason}"
    return StudyRecord(
        key=key, status=status, error=None, sigma=None, nees=float("inf"), iterations=0
    )
