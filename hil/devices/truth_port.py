"""The devices' view of the truth: its state as a function of time.

Frames: N inertial, B base body; `R_NB` maps B components to N. SI units.
"""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


class State(Protocol):
    """Truth at one instant, or at several along a leading axis."""

    @property
    def q(self) -> FloatArray:
        """Joint positions [rad]."""
        ...

    @property
    def qd(self) -> FloatArray:
        """Joint velocities [rad/s]."""
        ...

    @property
    def qdd(self) -> FloatArray:
        """Joint accelerations [rad/s^2]."""
        ...

    @property
    def tau(self) -> FloatArray:
        """Joint torques [N m]."""
        ...

    @property
    def R_NB(self) -> FloatArray:  # noqa: N802
        """Attitude, rotation matrix."""
        ...

    @property
    def w_NB_B(self) -> FloatArray:  # noqa: N802
        """Angular velocity of B, base axes [rad/s]."""
        ...

    @property
    def wd_NB_B(self) -> FloatArray:  # noqa: N802
        """Angular acceleration of B, base axes [rad/s^2]."""
        ...

    @property
    def a_NB_B(self) -> FloatArray:  # noqa: N802
        """Classical acceleration of the base origin, base axes [m/s^2]."""
        ...

    @property
    def g_NB_B(self) -> FloatArray:  # noqa: N802
        """Gravity at the base origin, base axes [m/s^2]; zero in plain free fall."""
        ...

    @property
    def gradient_B(self) -> FloatArray:  # noqa: N802
        """Gradient of gravity, base axes [1/s^2]."""
        ...


class History(Protocol):
    """Simulated truth as a function of time over [start_s, end_s]."""

    @property
    def start_s(self) -> float:
        """First time [s]."""
        ...

    @property
    def end_s(self) -> float:
        """Last time [s]."""
        ...

    def at(self, t_s: ArrayLike) -> State:
        """Return the state at the times [s]."""
        ...

    def wheels_at(self, t_s: float) -> tuple[FloatArray, FloatArray]:
        """Return speed [rad/s] and motor torque [N m] of every wheel."""
        ...
