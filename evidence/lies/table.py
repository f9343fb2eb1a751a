"""The lies: what a sensor's readings become, by sensor and kind, and the sizes that are tried.

Every lie creeps. It begins at an onset and acts on the readings of a clean flight:

gain : the readings grow by a factor 1 + size (t - onset) [1/s]
zero : an offset settles to a new value: size (1 - exp(-(t - onset) / SETTLE_S)) [unit]
drift : an offset grows without end: size (t - onset) [unit/s]
delay : the stamps fall behind: each reading is one of size (t - onset) before [s/s]
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from evidence.lies import KINDS, SENSORS
from evidence.methods.sensed import Channels
from hil.world.inertia import FloatArray

SETTLE_S = 5.0
SIZES = 5  # levels between the least and the largest size
SPAN = 1000.0  # largest size over the least one
VALUES: Mapping[str, str] = {
    "torque": "tau_nm",
    "encoder": "q_rad",
    "gyro": "w_NS_S_rad_s",
    "accelerometer": "f_NS_S_m_s2",
    "tracker": "R_NB",
}
LEAST: Mapping[str, Mapping[str, float]] = {  # sizes that no estimate of the bench can notice
    "torque": {"gain": 1e-6, "zero": 1e-3, "drift": 1e-4, "delay": 1e-6},
    "encoder": {"gain": 1e-6, "zero": 1e-5, "drift": 1e-6, "delay": 1e-6},
    "gyro": {"gain": 1e-6, "zero": 1e-6, "drift": 1e-7, "delay": 1e-6},
    "accelerometer": {"gain": 1e-5, "zero": 1e-5, "drift": 1e-6, "delay": 1e-6},
    "tracker": {"gain": 1e-6, "zero": 1e-6, "drift": 1e-7, "delay": 1e-6},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Lie:
    """One lie of one sensor.

    Attributes
    ----------
    size : in the unit of its kind
    axis : the joint or axis that lies, as a share of their number; None: all of them
    onset_s : time of the first wrong reading after the first sample
    """

    sensor: str
    kind: str
    size: float
    axis: float | None
    onset_s: float

    def on(self, clean: Channels) -> Channels:
        """Return the readings of a clean flight with this lie."""
        name, since_s = VALUES[self.sensor], np.maximum(clean.t_s - self.onset_s, 0.0)
        if self.sensor == "tracker":
            return replace(clean, R_NB=_turned(clean, self, since_s))
        values = getattr(clean, name)
        own = np.ones(values.shape[1])
        if self.axis is not None:
            own = np.eye(len(own))[int(self.axis * len(own))]
        lying: dict[str, Any] = {name: _CHANGES[self.kind](values, self.size, since_s, own)}
        return replace(clean, **lying)

    def __str__(self) -> str:
        """Return the lie in words."""
        which = "all" if self.axis is None else "one axis"
        return f"{self.sensor} {self.kind} {self.size:.2g} from {self.onset_s:.0f} s on, {which}"


def drawn(sensor: str, kind: str, level: int, rng: np.random.Generator) -> Lie:
    """Return a lie of one of the levels of size; the rest is drawn."""
    step = SPAN ** (1.0 / (SIZES - 1))
    size = LEAST[sensor][kind] * step**level * step ** float(rng.uniform(-0.5, 0.5))
    onset_s = float(rng.uniform(0.0, 40.0))
    axis = None if rng.random() < 1.0 / 3.0 else float(rng.random())
    return Lie(
        sensor=sensor, kind=kind, size=float(rng.choice([-1, 1])) * size, axis=axis, onset_s=onset_s
    )


def every() -> Iterator[tuple[str, str, int]]:
    """Yield sensor, kind and level of size of all lies."""
    for sensor in SENSORS:
        for kind in KINDS:
            for level in range(SIZES):
                yield sensor, kind, level


def _offset(kind: str, size: float, since_s: FloatArray) -> FloatArray:
    share = 1.0 - np.exp(-since_s / SETTLE_S) if kind == "zero" else since_s
    return np.asarray(size * share, np.float64)


def _gained(values: FloatArray, size: float, since_s: FloatArray, own: FloatArray) -> FloatArray:
    return np.asarray(values * (1.0 + size * np.outer(since_s, own)), np.float64)


def _settled(values: FloatArray, size: float, since_s: FloatArray, own: FloatArray) -> FloatArray:
    return np.asarray(values + np.outer(_offset("zero", size, since_s), own), np.float64)


def _drifted(values: FloatArray, size: float, since_s: FloatArray, own: FloatArray) -> FloatArray:
    return np.asarray(values + np.outer(_offset("drift", size, since_s), own), np.float64)


def _late(values: FloatArray, size: float, since_s: FloatArray, own: FloatArray) -> FloatArray:
    """Return values of a steady grid of one reading a step, each as it was some time before."""
    count = np.arange(len(values), dtype=np.float64)
    step_s = float(np.diff(since_s).max())  # the grid's; before the onset no time passes
    then = count - size * since_s / step_s if step_s else count
    late = np.stack([np.interp(then, count, column) for column in values.T], axis=1)
    return np.where(own > 0.0, late, values)


_CHANGES: Mapping[str, Callable[[FloatArray, float, FloatArray, FloatArray], FloatArray]] = {
    "gain": _gained,
    "zero": _settled,
    "drift": _drifted,
    "delay": _late,
}


def _turned(clean: Channels, lie: Lie, since_s: FloatArray) -> FloatArray:
    """Return the attitudes (N, 3, 3) of a tracker that lies.

    A gain stretches the rotation since the first solution; an offset turns the unit about an axis.
    """
    if lie.kind == "delay":
        then = np.clip(clean.t_s - lie.size * since_s, clean.t_s[0], clean.t_s[-1])
        return Slerp(clean.t_s, Rotation.from_matrix(clean.R_NB))(then).as_matrix()
    if lie.kind == "gain":
        first = Rotation.from_matrix(clean.R_NB[0])
        turn = (first.inv() * Rotation.from_matrix(clean.R_NB)).as_rotvec()
        return (
            first * Rotation.from_rotvec(turn * (1.0 + lie.size * since_s)[:, None])
        ).as_matrix()
    axis = np.ones(3) / np.sqrt(3.0)
    if lie.axis is not None:
        axis = np.eye(3)[int(3 * lie.axis)]
    by = Rotation.from_rotvec(np.outer(_offset(lie.kind, lie.size, since_s), axis))
    return (Rotation.from_matrix(clean.R_NB) * by).as_matrix()
