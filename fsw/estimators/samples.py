"""Sample sets: every channel known at every instant, errors white and independent.

What the batch methods work on, in the study and after the conditioning of a recording. SI units;
base axes B, inertial axes N; base acceleration is the classical one of the base origin.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from fsw.messages import FloatArray


def _none() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Noise:
    """1 sigma of one sample of each channel, independent; zero: exact."""

    tau_nm: FloatArray  # (n,)
    qdd_rad_s2: FloatArray  # (n,)
    w_rad_s: FloatArray = field(default_factory=_none)  # (3,)
    wd_rad_s2: FloatArray = field(default_factory=_none)
    a_m_s2: FloatArray = field(default_factory=_none)
    v_m_s: FloatArray = field(default_factory=_none)  # of v_NB_B, where there is one
    qd_rad_s: FloatArray | None = None  # (n,) None: exact; CE alone heeds it

    @staticmethod
    def of(
        n: int,
        *,
        tau_nm: float,
        qdd_rad_s2: float = 0.0,
        w_rad_s: float = 0.0,
        wd_rad_s2: float = 0.0,
        a_m_s2: float = 0.0,
        v_m_s: float = 0.0,
    ) -> Noise:
        """Return the same sigma for every joint and axis of a channel."""
        return Noise(
            tau_nm=np.full(n, tau_nm),
            qdd_rad_s2=np.full(n, qdd_rad_s2),
            w_rad_s=np.full(3, w_rad_s),
            wd_rad_s2=np.full(3, wd_rad_s2),
            a_m_s2=np.full(3, a_m_s2),
            v_m_s=np.full(3, v_m_s),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointCurve:
    """The joints' motion as one curve linear in k coefficients, fitted to noisy angles."""

    basis: FloatArray  # (3, N, k) angle, rate, acceleration at the samples
    coefficients: FloatArray  # (k, n)
    covariance: FloatArray  # (k, k) of the coefficients of every joint

    def information(self) -> FloatArray:
        """Return the inverse of the covariance."""
        inverse = np.linalg.solve(self.covariance, np.eye(len(self.covariance)))
        symmetric: FloatArray = 0.5 * (inverse + inverse.T)
        return symmetric


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampleSet:
    """N samples of an arm with n joints, in time order.

    Joint positions and rates are taken as exact (the rates not by CE). Where there is a curve the
    fused method solves for the motion along.
    """

    t_s: FloatArray  # (N,)
    q: FloatArray  # (N, n)
    qd: FloatArray  # (N, n)
    qdd: FloatArray  # (N, n)
    tau: FloatArray  # (N, n)
    w_NB_B: FloatArray  # (N, 3)
    wd_NB_B: FloatArray  # (N, 3)
    a_NB_B: FloatArray  # (N, 3)
    R_NB: FloatArray  # (N, 3, 3)
    noise: Noise
    v_NB_B: FloatArray | None = None  # (N, 3) base velocity; no flight sensor gives it
    curve: JointCurve | None = None  # what q, qd and qdd come from

    def __post_init__(self) -> None:
        """Make every array contiguous and read-only; check the shapes and that all is finite."""
        N, n = self.q.shape
        wanted = {
            "t_s": (N,), "q": (N, n), "qd": (N, n), "qdd": (N, n), "tau": (N, n),
            "w_NB_B": (N, 3), "wd_NB_B": (N, 3), "a_NB_B": (N, 3), "R_NB": (N, 3, 3),
        }  # fmt: skip
        if self.v_NB_B is not None:
            wanted["v_NB_B"] = (N, 3)
        for name, shape in wanted.items():
            value = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if value.shape != shape:
                raise ValueError(f"{name} has shape {value.shape}; must be {shape}")
            if not np.all(np.isfinite(value)):
                raise ValueError(
                    f"{name} holds {int((~np.isfinite(value)).sum())} non-finite values"
                )
            value = value.view()
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    def take(self, index: slice) -> SampleSet:
        """Return some of the samples."""
        return replace(
            self,
            t_s=self.t_s[index],
            q=self.q[index],
            qd=self.qd[index],
            qdd=self.qdd[index],
            tau=self.tau[index],
            w_NB_B=self.w_NB_B[index],
            wd_NB_B=self.wd_NB_B[index],
            a_NB_B=self.a_NB_B[index],
            R_NB=self.R_NB[index],
            v_NB_B=None if self.v_NB_B is None else self.v_NB_B[index],
            curve=None
            if self.curve is None
            else replace(self.curve, basis=self.curve.basis[:, index]),
        )


def with_noise(exact: SampleSet, noise: Noise, rng: np.random.Generator) -> SampleSet:
    """Return the samples with Gaussian errors of the given sigmas added."""

    def add(values: FloatArray, sigma: FloatArray) -> FloatArray:
        return values + sigma * rng.standard_normal(values.shape)

    return replace(
        exact,
        tau=add(exact.tau, noise.tau_nm),
        qd=exact.qd if noise.qd_rad_s is None else add(exact.qd, noise.qd_rad_s),
        qdd=add(exact.qdd, noise.qdd_rad_s2),
        w_NB_B=add(exact.w_NB_B, noise.w_rad_s),
        wd_NB_B=add(exact.wd_NB_B, noise.wd_rad_s2),
        a_NB_B=add(exact.a_NB_B, noise.a_m_s2),
        v_NB_B=None if exact.v_NB_B is None else add(exact.v_NB_B, noise.v_m_s),
        noise=noise,
    )
