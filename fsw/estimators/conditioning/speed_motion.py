"""Angles of joints whose encoders give speed only: the integral of speed over the windows.

Within a window the angle is the integral of the polynomial fitted to the speeds. The integrals add
up from window to window, and so does their noise: the angle has a random walk, whose variance each
block holds for the estimator (see `model/walks.py`). A gap without speeds is bridged. If the bridge
is too uncertain, the angle is lost.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.polynomial import legendre

from fsw.config import JointConfig
from fsw.estimators.conditioning.polynomial import WindowFit
from fsw.messages import Block, FloatArray

SHORT_WINDOWS = 2.0  # windows; in a longer gap the speed limit alone gives the error of the bridge
LOST_RAD = 0.5  # 1 sigma of the bridge of a gap above which the angles are lost


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """Values of the integrals at the end of a window; arrays over the joints of `own`."""

    t_ns: int
    q_rad: FloatArray
    qd_rad_s: FloatArray
    qdd_rad_s2: FloatArray
    walk_rad2: FloatArray


class SpeedMotion:
    """Integrates speeds from window to window; does nothing if every encoder gives positions.

    Attributes
    ----------
    own : indices, in the model's order, of the joints whose encoders give speed
    lost : whether a gap was so long that the angles are unknown
    """

    def __init__(
        self, joints: Sequence[JointConfig], nodes: int, rates_hz: Mapping[str, float]
    ) -> None:
        """`rates_hz`: rates of the buses by name."""
        self.own = [k for k, joint in enumerate(joints) if joint.speed_only]
        self.lost = False
        self._start_rad = np.array([joints[k].start_rad for k in self.own], float)
        self._sigma = np.array([joints[k].speed_noise_rad_s for k in self.own], float)
        self._density = self._sigma**2 / np.array([rates_hz[joints[k].bus] for k in self.own])
        self._limit_rad_s = np.array([joints[k].speed_limit_rad_s for k in self.own])
        self._weights = legendre.leggauss(nodes)[1]
        self._count = len(joints)
        self._end: _End | None = None

    def take_over(self, other: Self) -> None:
        """Continue from the integrals of another object of the same joints."""
        self._end, self.lost = other._end, other.lost

    def resume(self, block: Block, window_s: float) -> None:
        """Continue from the end of a block that was made before a restart."""
        if not self.own or not block.walk_rad2.size:
            return
        half_ns = round(0.5e9 * window_s)
        end_ns = (int(block.t_ns[0]) + int(block.t_ns[-1])) // 2 + half_ns
        own, rest_s = self.own, (end_ns - int(block.t_ns[-1])) * 1e-9
        q, qd, qdd = (v[-1, own] for v in (block.q_rad, block.qd_rad_s, block.qdd_rad_s2))
        walk = block.walk_rad2[own] + self._density * window_s
        q, qd = q + rest_s * (qd + 0.5 * rest_s * qdd), qd + rest_s * qdd
        self._end = _End(end_ns, q, qd, qdd, walk)

    def added(
        self, motion: FloatArray, fits: Sequence[WindowFit], start_ns: int, stop_ns: int
    ) -> FloatArray:
        """Add the angles at the window's start to `motion`; return the variance of the walk there.

        Parameters
        ----------
        motion : (3, m, n) positions (of `own` from the window's start), rates, accelerations;
            changed in place
        fits : polynomial of each joint's samples in the window

        Returns
        -------
        (n,) variance [rad^2], zero for the joints with positions; empty without `own`
        """
        if not self.own:
            return np.zeros(0)
        half_s, own = (stop_ns - start_ns) * 0.5e-9, self.own
        rate, acceleration = motion[1][:, own], motion[2][:, own]
        q, walk = self._at_start(start_ns, 2.0 * half_s, rate[0], acceleration[0])
        motion[0][:, own] += q
        through = half_s * self._weights
        self._end = _End(
            stop_ns,
            q + through @ rate,
            rate[-1],
            acceleration[-1],
            walk + [through @ fits[k].covariance((0,), s) @ through for k, s in self._sigmas()],
        )
        every = np.zeros(self._count)
        every[own] = walk
        return every

    def _sigmas(self) -> list[tuple[int, float]]:
        return list(zip(self.own, self._sigma.tolist(), strict=True))

    def _at_start(
        self, start_ns: int, window_s: float, rate: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return angles and walk variances of `own` at a window's start, across a gap before it.

        The bridge is the mean speed at the gap's ends. Its error follows from the difference of
        these speeds and the accelerations; in a long gap, from the speed limit.
        """
        end = self._end
        if end is None:
            return self._start_rad, np.zeros(len(self.own))
        gap_s = (start_ns - end.t_ns) * 1e-9
        if gap_s <= 0.0:
            return end.q_rad, end.walk_rad2
        bent = np.abs(rate - end.qd_rad_s)
        bent = bent + 0.5 * gap_s * (np.abs(acceleration) + np.abs(end.qdd_rad_s2))
        sigma = 0.5 * gap_s * bent
        if gap_s > SHORT_WINDOWS * window_s:
            sigma = gap_s * self._limit_rad_s / np.sqrt(3.0)
        self.lost |= bool((sigma > LOST_RAD).any())
        q = end.q_rad + 0.5 * gap_s * (end.qd_rad_s + rate)
        return q, end.walk_rad2 + self._density * gap_s + sigma**2
