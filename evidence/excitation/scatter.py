"""Compare the predicted scatter with that of noisy samples through the flight estimator."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from evidence.excitation import cases
from fsw.estimators.batch.solver import solve
from fsw.estimators.conditioning.blocks import build_conditioner
from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.model.inertia import is_consistent
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, ChannelWindow, Window
from hil.world.history import TruthHistory, TruthState
from hil.world.inertia import FloatArray
from hil.world.truth import simulate
from planner import criteria
from planner.assess import information_root
from planner.spline import Trajectory

CONFIDENCE = 0.99


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scatter:
    """Errors of the runs in units of the predicted covariance."""

    names: tuple[str, ...]  # of the parameters
    runs: int
    pooled_ratio: float  # rms of the errors of all parameters, whitened by the prediction
    chi_square: FloatArray  # (p,) sum over the runs of (error / predicted sigma)^2
    interval: tuple[float, float]  # chi-square interval of one parameter's sum
    not_converged: int  # runs

    @property
    def outside(self) -> list[str]:
        """The names of the parameters whose sum is outside the interval."""
        low, high = self.interval
        pairs = zip(self.names, self.chi_square, strict=True)
        return [name for name, value in pairs if not low <= value <= high]


def scatter(
    system: str,
    trajectory: Trajectory,
    runs: int,
    seed: int = 0,
    say: Callable[[str], None] = lambda _text: None,
) -> Scatter:
    """Simulate `runs` flights of one trajectory and estimate the unknown bodies in each flight.

    Noise, biases, offsets and prior mean are drawn for each run, from the distributions that the
    configuration declares.
    """
    own = cases.subject(system)
    problem, p = own.problem, len(own.x)
    spline = cases.joint_spline(trajectory)
    history = simulate(cases.truth(system), spline, 0.0, spline.duration_s + 0.01, 0.005)
    flight = _Flight(own.config.estimator.window_s, history, spline.duration_s)
    C = criteria.covariance(information_root(own, trajectory, 5.0), p)[:p]
    L = np.linalg.cholesky(0.5 * (C + C.T))
    sigma = np.sqrt(np.diag(C))
    errors, failed = np.empty((runs, p)), 0
    for run in range(runs):
        rng = np.random.default_rng([seed, run])
        conditioner = build_conditioner(own.config, own.model)
        blocks = [conditioner.condition(window) for window in flight.windows(rng)]
        kept: list[Block] = [block for block in blocks if block is not None]
        drawn = replace(problem, prior_mean=_drawn_prior(problem, own.x, rng))
        start = drawn.prior_mean.copy()
        start[:p] = own.x
        found = solve(drawn, row_function("fused", "eiv", drawn), kept, start=start)
        failed += found.status != "OK"
        errors[run] = found.mean[:p] - own.x
        if run % 10 == 9:
            white = np.linalg.solve(L, errors[: run + 1].T)
            say(f"{system}: {run + 1} runs, pooled ratio {np.sqrt(np.mean(white**2)):.4f}")
    white = np.linalg.solve(L, errors.T)
    tail = 0.5 * (1 - CONFIDENCE)
    return Scatter(
        names=problem.names[:p],
        runs=runs,
        pooled_ratio=float(np.sqrt(np.mean(white**2))),
        chi_square=np.sum((errors / sigma) ** 2, axis=0),
        interval=(float(chi2.ppf(tail, runs)), float(chi2.ppf(1 - tail, runs))),
        not_converged=failed,
    )


def _drawn_prior(problem: Problem, truth: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return a prior mean drawn about the true bodies; the biases keep the mean zero."""
    L = np.linalg.cholesky(problem.prior_covariance[problem.bodies, problem.bodies])
    mean = problem.prior_mean.copy()
    for _ in range(10_000):
        drawn = truth + L @ rng.standard_normal(len(truth))
        if all(is_consistent(drawn[problem.body(name)]) for name in problem.unknown):
            mean[problem.bodies] = drawn
            break
    return mean


class _Flight:
    """Exact signals of one flight at the sample times, which `windows` returns with noise."""

    def __init__(self, window_s: float, history: TruthHistory, duration_s: float) -> None:
        self._window_s = window_s
        self._count = round(window_s * cases.RATE_HZ)
        self._windows = int(np.floor(duration_s / window_s + 1e-9))
        self._t_s = (np.arange(self._count * self._windows) + 0.5) / cases.RATE_HZ
        state = history.at(self._t_s)
        self._q, self._tau = state.q, state.tau
        self._w, self._f = state.w_NB_B, _specific_force(state)

    def windows(self, rng: np.random.Generator) -> list[Window]:
        """Return every window with newly drawn noise, offsets and biases."""
        root = cases.RATE_HZ**0.5
        normal = rng.standard_normal
        q = self._q + cases.POSITION_NOISE_RAD * normal(self._q.shape)
        tau = self._tau + cases.TORQUE_NOISE_NM * normal(self._tau.shape)
        tau += cases.TORQUE_OFFSET_SIGMA_NM * normal(self._tau.shape[1])
        w = self._w + cases.RATE_NOISE * root * normal(self._w.shape)
        f = self._f + cases.FORCE_NOISE * root * normal(self._f.shape)
        w += cases.GYRO_BIAS_SIGMA_RAD_S * normal(3)
        f += cases.ACC_BIAS_SIGMA_M_S2 * normal(3)
        found = []
        for k in range(self._windows):
            part = slice(k * self._count, (k + 1) * self._count)
            t_ns = np.rint(self._t_s[part] * 1e9).astype(np.int64)
            joints = [np.stack([q[part, j], tau[part, j]], axis=1) for j in range(q.shape[1])]
            found.append(
                Window(
                    index=k,
                    start_ns=round(k * self._window_s * 1e9),
                    stop_ns=round((k + 1) * self._window_s * 1e9),
                    joints=tuple(_channel(t_ns, values) for values in joints),
                    gyro=_channel(t_ns, w[part]),
                    accelerometer=_channel(t_ns, f[part]),
                    attitude=ChannelWindow(
                        t_ns=np.empty(0, dtype=np.int64),
                        values=np.empty((0, 4)),
                        missing=True,
                        stale=False,
                    ),
                )
            )
        return found


def _channel(t_ns: np.ndarray, values: FloatArray) -> ChannelWindow:
    return ChannelWindow(t_ns=t_ns, values=values, missing=False, stale=False)


def _specific_force(state: TruthState) -> FloatArray:
    r, w = np.array(cases.SENSOR_B_M), state.w_NB_B
    return np.asarray(state.a_NB_B + np.cross(state.wd_NB_B, r) + np.cross(w, np.cross(w, r)))
