"""Ports and clock of one daemon over many plants; a new plant power-cycles every device."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import ArrayLike

from fsw.drivers.wire import ByteChunk, CanFrame, FrameArray
from fsw.errors import PortError
from fsw.loop.ports import Ports
from hil.links.virtual import VirtualBench, VirtualCan, VirtualSerial
from hil.world.history import FloatArray, TruthHistory, TruthState
from hil.world.scenario import BUS

ODD = ("qd", "v_NB_N", "w_NB_B")  # fields that change their sign when time runs backwards


class Reversed:
    """A motion in reversed time; with zero momentum, the same torques produce this motion."""

    def __init__(self, history: TruthHistory) -> None:
        self._history = history
        self._sum_s = history.start_s + history.end_s

    @property
    def start_s(self) -> float:
        """The first time [s]."""
        return self._history.start_s

    @property
    def end_s(self) -> float:
        """The last time [s]."""
        return self._history.end_s

    def at(self, t_s: ArrayLike) -> TruthState:
        """Return the states at the times [s]."""
        state = self._history.at(self._sum_s - np.asarray(t_s))
        signs = {name: -getattr(state, name) for name in ODD if name in _NAMES}
        return replace(state, t_s=np.asarray(t_s, dtype=np.float64), **signs)

    def wheels_at(self, t_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the speed [rad/s] and the motor torque [N m] of every wheel."""
        speed, torque = self._history.wheels_at(self._sum_s - t_s)
        return -speed, torque


_NAMES = {field.name for field in fields(TruthState)}


class PortLane:
    """The daemon's clock and ports; `exchange` replaces the bench behind them."""

    def __init__(self, bench: VirtualBench) -> None:
        self.bench = bench
        self.can = _Can(self)
        self.serials = {name: _Serial(self, name) for name in bench.serials}
        self._pushed_ns = 0

    def exchange(self, bench: VirtualBench) -> None:
        """Continue with another bench; every port fails until it is opened again."""
        self.bench = bench
        self._pushed_ns = 0
        self.can.unplugged = True
        for line in self.serials.values():
            line.unplugged = True

    def ports(self) -> Ports:
        """Return the daemon's ports; a failed port works again when it is opened again."""
        lines = self.serials
        return Ports(
            can={BUS: self.can},
            imu=lines["imu"],
            star_tracker=lines.get("star_tracker"),
            can_openers={BUS: self.can.opened},
            line_openers={name: line.opened for name, line in lines.items()},
        )

    def now_ns(self) -> int:
        """Return the simulated time [ns]."""
        return self.bench.clock.now_ns() + self._pushed_ns

    def cpu_time_ns(self) -> int:
        """Return 0: work takes no simulated time."""
        return 0

    def sleep_until_ns(self, deadline_ns: int, wake_fds: Sequence[int] = ()) -> bool:
        """Sleep on the bench's clock; the time of a hold passes first."""
        if self._pushed_ns:
            self.bench.clock.sleep_until_ns(self.now_ns())
            self._pushed_ns = 0
        return self.bench.clock.sleep_until_ns(deadline_ns, wake_fds)

    def hold_until_ns(self, t_ns: int) -> None:
        """Advance the time to `t_ns` without the daemon, as if it had no processor."""
        self._pushed_ns += max(0, t_ns - self.now_ns())


class _Can:
    """The CAN port of the lane."""

    hands_back = False

    def __init__(self, lane: PortLane) -> None:
        self._lane = lane
        self.unplugged = False

    @property
    def _port(self) -> VirtualCan:
        return self._lane.bench.can

    def opened(self) -> _Can:
        self.unplugged = False
        return self

    def drain(self) -> None:
        _refuse(self.unplugged)
        self._port.drain()

    def take(self) -> Callable[[], FrameArray]:
        return self._port.take()

    def write(self, can_id: int, data: bytes) -> CanFrame:
        _refuse(self.unplugged)
        return self._port.write(can_id, data)

    def wake_fds(self) -> tuple[int, ...]:
        return ()

    def take_dropped(self) -> int:
        return self._port.take_dropped()

    def close(self) -> None:
        self._port.close()


class _Serial:
    """A serial port of the lane."""

    def __init__(self, lane: PortLane, device: str) -> None:
        self._lane, self._device = lane, device
        self.unplugged = False

    @property
    def _port(self) -> VirtualSerial:
        return self._lane.bench.serials[self._device]

    def opened(self) -> _Serial:
        self.unplugged = False
        return self

    def read(self) -> list[ByteChunk]:
        _refuse(self.unplugged)
        return self._port.read()

    def write(self, data: bytes) -> None:
        _refuse(self.unplugged)
        self._port.write(data)

    def wake_fds(self) -> tuple[int, ...]:
        return self._port.wake_fds()

    def close(self) -> None:
        self._port.close()


def _refuse(unplugged: bool) -> None:
    if unplugged:
        raise PortError("unplugged")
