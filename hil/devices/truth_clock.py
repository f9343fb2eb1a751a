"""Truth time on the host's clock, and fast evaluation of the truth at single instants."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.devices.truth_port import FloatArray, History, State
from hil.world.motor_side import MotorSide

REST_S = -1.0  # a time before the motion, at which the robot rests
GRID_S = 1e-3
GRID_POINTS = 256
SPAN_S = 0.2  # longest span of times in one call of JointTable.at


@dataclass(slots=True)
class TruthClock:
    """Truth time on the host's clock; until the first SYNC all times are REST_S."""

    start_delay_s: float
    origin_ns: int | None = None

    def start(self, first_sync_ns: int) -> None:
        """Set the origin from the first SYNC; later calls change nothing."""
        if self.origin_ns is None:
            self.origin_ns = first_sync_ns + round(self.start_delay_s * 1e9)

    def seconds(self, t_ns: NDArray[np.int64]) -> FloatArray:
        """Return the truth times [s] of host times (k,) [ns]."""
        if self.origin_ns is None:
            return np.full(len(t_ns), REST_S)
        return np.asarray((t_ns - self.origin_ns) * 1e-9, dtype=np.float64)

    def second(self, t_ns: int) -> float:
        """Return the truth time [s] of one host time [ns]."""
        return REST_S if self.origin_ns is None else (t_ns - self.origin_ns) * 1e-9


class ClampedHistory:
    """A history that keeps its first state before the start and its last after the end."""

    def __init__(self, history: History) -> None:
        self._history = history

    def at(self, t_s: FloatArray) -> State:
        """Return the state at the times, shape (k,)."""
        return self._history.at(np.clip(t_s, self._history.start_s, self._history.end_s))

    def wheels_at(self, t_s: float) -> tuple[FloatArray, FloatArray]:
        """Return speed [rad/s] and motor torque [N m] of every wheel."""
        return self._history.wheels_at(t_s)


class JointTable:
    """Joint positions, velocities and torques, interpolated on a 1 ms grid.

    The error of four-point Lagrange interpolation is below 3e-14 s^4 times the fourth derivative,
    below 1e-10 rad and N m for the motions of a space arm. The grid is filled in batches.
    """

    def __init__(self, history: ClampedHistory) -> None:
        self._history = history
        self._motors: MotorSide | None = None
        self._first = 0
        self._table = np.empty((0, 0))
        self.n = int(np.atleast_2d(history.at(np.array([REST_S])).q).shape[-1])

    def measure_at_motors(self, motors: MotorSide) -> None:
        """Return torques at the motors from now on: those of the links and of the motor side."""
        self._motors, self._table = motors, np.empty((0, 0))

    def at(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q [rad], qd [rad/s], tau [N m], each (k, n), at rising times within `SPAN_S`."""
        cell = t_s / GRID_S
        base = np.floor(cell).astype(np.int64)
        first, last = int(base[0]), int(base[-1])
        if not self._first < first <= last < self._first + len(self._table) - 2:
            self._fill(first)
        x = cell - base
        weights = np.stack(
            [
                -x * (x - 1.0) * (x - 2.0) / 6.0,
                (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
                -(x + 1.0) * x * (x - 2.0) / 2.0,
                (x + 1.0) * x * (x - 1.0) / 6.0,
            ],
            axis=1,
        )
        rows = (base - self._first - 1)[:, None] + np.arange(4)
        values = (weights[:, None] @ self._table[rows])[:, 0]
        n = self.n
        return values[:, :n], values[:, n : 2 * n], values[:, 2 * n :]

    def _fill(self, base: int) -> None:
        self._first = base - 2
        state = self._history.at((self._first + np.arange(GRID_POINTS, dtype=np.float64)) * GRID_S)
        tau = state.tau
        if self._motors is not None:
            tau = tau + self._motors.torque_nm(state.q, state.qdd)
        self._table = np.hstack([state.q, state.qd, tau])
