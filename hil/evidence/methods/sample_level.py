"""Sample level: exact samples plus white noise, every method, one seed."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from fsw.estimators.model.problem import Problem
from fsw.estimators.samples import Noise, SampleSet, with_noise
from fsw.messages.errors import EstimatorError
from hil.evidence.methods.cases import (
    SAMPLE,
    SENSOR_SETS,
    Key,
    Record,
    SensorSet,
    scenario_of,
    truth_of,
)
from hil.evidence.methods.exact import base_velocity, exact_samples
from hil.evidence.methods.flight_side import problem_of, without_biases, write_config
from hil.evidence.methods.methods import Outcome, on_samples
from hil.judge.score import normalised_error_squared
from hil.world.inertia import FloatArray

NOISE_STREAM = 113  # spawn key of the samples' noise, apart from the priors' and the devices'


def run_seed(case: str, sensors: str, seed: int, methods: Sequence[str]) -> list[Record]:
    """Return the results of some methods on one noisy sample set.

    The unit noise of a seed is the same for every case and sensor set; the prior, drawn from the
    same seed, is where the iterations start.
    """
    problem = _problem(case, seed)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(NOISE_STREAM,)))
    samples = with_noise(_samples(case), _noise(SENSOR_SETS[sensors], problem.model.n), rng)
    records = []
    for method in methods:
        key = Key(level=SAMPLE, case=case, sensors=sensors, method=method, seed=seed)
        try:
            outcome = on_samples(method, samples, problem)
        except (EstimatorError, np.linalg.LinAlgError) as error:
            records.append(failed(key, str(error)))
            continue
        records.append(judged(key, outcome, truth_of(case)))
    return records


def judged(key: Key, outcome: Outcome, truth: FloatArray) -> Record:
    """Return the record of a method's outcome against the truth; not finite: failed."""
    error, covariance = outcome.x - truth, outcome.covariance
    if not (np.all(np.isfinite(error)) and np.all(np.isfinite(covariance))):
        return failed(key, f"{outcome.status}: not finite")
    variance = np.diag(covariance)
    if not np.all(variance > 0):
        return failed(key, f"{outcome.status}: covariance not positive")
    return Record(
        key=key,
        status=outcome.status,
        error=error,
        sigma=np.sqrt(variance),
        nees=normalised_error_squared(error, covariance),
        iterations=outcome.iterations,
        bias_note=outcome.bias_note,
    )


def failed(key: Key, reason: str) -> Record:
    """Return the record of a method that gave nothing."""
    status = f"FAILED: {reason}"
    return Record(key=key, status=status, error=None, sigma=None, nees=float("inf"), iterations=0)


@lru_cache(maxsize=3)
def _samples(case: str) -> SampleSet:
    state = exact_samples(case)
    n = state.q.shape[1]
    return SampleSet(
        t_s=state.t_s,
        q=state.q,
        qd=state.qd,
        qdd=state.qdd,
        tau=state.tau,
        w_NB_B=state.w_NB_B,
        wd_NB_B=state.wd_NB_B,
        a_NB_B=state.a_NB_B,
        R_NB=state.R_NB,
        noise=Noise.of(n, tau_nm=0.0),
        v_NB_B=base_velocity(state),
    )


def _noise(sensors: SensorSet, n: int) -> Noise:
    return Noise.of(
        n,
        tau_nm=sensors.torque_nm,
        qdd_rad_s2=sensors.qdd_rad_s2,
        w_rad_s=sensors.rate_rad_s,
        wd_rad_s2=sensors.angular_acceleration_rad_s2,
        a_m_s2=sensors.acceleration_m_s2,
        v_m_s=sensors.velocity_m_s,
    )


def _problem(case: str, seed: int) -> Problem:
    with tempfile.TemporaryDirectory(prefix="study-") as folder:
        return problem_of(write_config(without_biases(scenario_of(case)), seed, Path(folder)))
