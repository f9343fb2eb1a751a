"""Sample sets of the true motion and the truth of the unknown bodies, for the batch methods."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fsw.estimators.methods.result import BatchResult
from fsw.estimators.model.problem import Problem
from fsw.estimators.samples import Noise, SampleSet
from fsw.messages import Block
from tests.support.estimator_cases import BASE, TARGET, N, motion, parameters, robot_model, wrong

TRUE = {"base": parameters(BASE), "target": parameters(TARGET)}
PLAIN = Noise.of(N, tau_nm=0.05, wd_rad_s2=1e-3, a_m_s2=1e-3)
FULL = Noise.of(N, tau_nm=0.05, w_rad_s=4e-4, wd_rad_s2=1e-2, a_m_s2=5e-3)
FINE = Noise.of(N, tau_nm=0.0158, w_rad_s=1.5e-4, wd_rad_s2=1e-3, a_m_s2=5e-3)  # 0.05 at 500 Hz


@lru_cache(maxsize=4)
def exact(kind: str, rate_hz: float = 50.0, duration_s: float = 60.0) -> SampleSet:
    t = np.arange(0.0, duration_s - 1e-9, 1.0 / rate_hz)
    s = motion(kind).at(t)
    return SampleSet(
        t_s=t,
        q=s.q,
        qd=s.qd,
        qdd=s.qdd,
        tau=s.tau,
        w_NB_B=s.w_NB_B,
        wd_NB_B=s.wd_NB_B,
        a_NB_B=s.a_NB_B,
        R_NB=s.R_NB,
        noise=Noise.of(N, tau_nm=1e-6, w_rad_s=1e-9, a_m_s2=1e-8, v_m_s=1e-8),
        v_NB_B=None,
    )


def samples_of(block: Block, count: int, spacing_s: float = 0.0) -> SampleSet:
    """Return the first nodes of a block as samples, at other times if asked for."""
    part = slice(0, count)
    return SampleSet(
        t_s=block.t_ns[part] * 1e-9 + spacing_s * np.arange(count),
        q=block.q_rad[part],
        qd=block.qd_rad_s[part],
        qdd=block.qdd_rad_s2[part],
        tau=block.tau_nm[part],
        w_NB_B=block.w_NB_B_rad_s[part],
        wd_NB_B=block.wd_NB_B_rad_s2[part],
        a_NB_B=block.f_NS_B_m_s2[part],
        R_NB=block.R_NB[part],
        noise=Noise.of(N, tau_nm=1.0, w_rad_s=1.0, a_m_s2=1.0),
    )


def truth(problem: Problem) -> np.ndarray:
    x = np.zeros(len(problem.names))
    for name in problem.unknown:
        x[problem.body(name)] = TRUE[name]
    return x


def start(problem: Problem, seed: int) -> np.ndarray:
    """Return bodies with every component 30-50 % off."""
    rng = np.random.default_rng(seed)
    bodies = {"base": BASE, "target": TARGET}
    return np.concatenate([parameters(wrong(bodies[name], rng)) for name in problem.unknown])


def nees(result: BatchResult, problem: Problem) -> float:
    """Return the normalised squared error of the bodies."""
    k = problem.bodies
    e = result.mean[k] - truth(problem)[k]
    return float(e @ np.linalg.solve(result.covariance[k, k], e))


def band(dof: int, seeds: int) -> tuple[float, float]:
    """Return the 99.9 % band of the sum of `seeds` NEES (fixed seeds: the test is repeatable)."""
    from scipy.stats import chi2

    low, high = chi2.ppf([5e-4, 1 - 5e-4], dof * seeds)
    return float(low), float(high)


__all__ = ["FINE", "FULL", "PLAIN", "band", "exact", "nees", "robot_model", "start", "truth"]
