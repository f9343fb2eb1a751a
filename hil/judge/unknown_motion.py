"""What an unknown motion of the joints costs the information about everything else.

Each joint's angle is a spline of degree five on uniform knots, as smooth as the motions that this
bench flies, with free coefficients c. Encoders and all other sensors show them. With the Fisher
information F of parameters x and coefficients, x keeps

    F_xx - F_xc F_cc^-1 F_cx

F_cc is banded, since six splines are not zero at any time. An encoder's rounding counts as noise of
its variance, step^2 / 12. That is the bound of every estimator that is linear in the readings. It
is too low where a joint stays on one count for long: errors are alike there and do not average. It
is too high in principle where a joint crosses many counts: an instant of change says more.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import solveh_banded

from hil.world.inertia import FloatArray
from hil.world.spline import DEGREE

ACTIVE = DEGREE + 1  # splines that are not zero at a time
ORDERS = (0, 1, 2)  # derivatives of an angle that the sensors depend on
# from 0.1 to 1 s the bound of `target_leo` with 14 to 24 bits changes by less than 4e-4
KNOT_SPACING_S = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Encoders:
    """White noise per sample of n joints' angles, or of their speeds.

    A joint has an angle's noise or a speed's; the other is infinite. The angle at the start is
    known to `start_sigma_rad` in addition.
    """

    rate_hz: float
    angle_noise_rad: FloatArray  # (n,)
    speed_noise_rad_s: FloatArray  # (n,)
    start_sigma_rad: FloatArray  # (n,) infinite: it is not known


class UnknownMotion:
    """Information about parameters and motion, summed over instants at `rate_hz`.

    Parameters
    ----------
    count : number of instants
    size : number of parameters
    """

    def __init__(self, encoders: Encoders, count: int, rate_hz: float, size: int) -> None:
        self._n = n = len(encoders.angle_noise_rad)
        inner = max(1, round((count - 1) / rate_hz / KNOT_SPACING_S))
        knots = np.linspace(0.0, (count - 1) / rate_hz, inner + 1)
        knots = np.concatenate([np.zeros(DEGREE), knots, np.full(DEGREE, knots[-1])])
        basis = BSpline(knots, np.eye(inner + DEGREE), DEGREE)
        t_s = np.arange(count) / rate_hz
        values = [np.asarray(basis.derivative(d)(t_s) if d else basis(t_s)) for d in ORDERS]
        first = np.searchsorted(knots, t_s, side="right") - 1 - DEGREE
        self._first = np.clip(first, 0, inner - 1)
        places = self._first[:, None] + np.arange(ACTIVE)
        self._values = np.stack([np.take_along_axis(v, places, 1) for v in values], 1)
        self._band = np.zeros((ACTIVE * n, (inner + DEGREE) * n))
        self._cross = np.zeros((size, self._band.shape[1]))
        self._lower = np.tril_indices(ACTIVE * n)
        noise = np.array([encoders.angle_noise_rad, encoders.speed_noise_rad_s])
        self._weights = encoders.rate_hz / rate_hz / noise**2  # (2, n)
        start = self._values[0, 0]
        known = np.kron(np.outer(start, start), np.diag(encoders.start_sigma_rad**-2.0))
        self._put(0, np.asarray(known, np.float64))

    def add(self, k: int, A: FloatArray, by_motion: FloatArray, weights: FloatArray) -> None:
        """Add the samples of instant k.

        Parameters
        ----------
        A, by_motion : (r, size), (r, 3 n) derivatives of r readings by parameters and by q, qd, qdd
        weights : (r,) information of these readings
        """
        n, B = self._n, self._values[k]  # (3, 6)
        D = by_motion.reshape(-1, len(ORDERS), n)
        G = np.einsum("rdj,da->raj", D, B).reshape(len(D), -1)
        own = G.T @ (weights[:, None] * G)
        for order, weight in enumerate(self._weights):
            own += np.kron(np.outer(B[order], B[order]), np.diag(weight))
        self._put(k, own)
        start = self._first[k] * n
        self._cross[:, start : start + ACTIVE * n] += A.T @ (weights[:, None] * G)

    def cost(self) -> FloatArray:
        """Return the information (size, size) that the parameters lose by the unknown motion."""
        return np.asarray(self._cross @ solveh_banded(self._band, self._cross.T, lower=True))

    def _put(self, k: int, own: FloatArray) -> None:
        rows, columns = self._lower
        self._band[rows - columns, self._first[k] * self._n + columns] += own[rows, columns]
