"""Samples of NumPy arrays: a recording of them, and what they show of their sensors."""

from __future__ import annotations

from collections.abc import Mapping as Values
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fsw.config import Config
from fsw.errors import ConfigError, brief
from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray
from offline.importing import write
from offline.importing.columns import Columns
from offline.importing.mapping import Mapping
from offline.importing.samples import sampled_channels
from offline.importing.tables import Table
from offline.init.noise import noise_of, noise_of_turns, rate_of, sizes_of
from offline.init.recording import Recorded

LEAST = 8  # least number of rows
LEAST_HZ = 2.0  # slower joints and inertial units fill no window: probably milliseconds
TIMES = ("t_s", "t_imu_s", "t_attitude_s")
WIDTHS = {"gyro_rad_s": 3, "specific_force_m_s2": 3, "q_NB_xyzw": 4}
NAME = Path("samples")  # of the arrays in messages
SI = {"revolute": ("rad", "N m"), "prismatic": ("m", "N")}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """Arrays of sampled data in SI units, one row a sample; a sensor without arrays is None.

    Parameters
    ----------
    t_s : (k,) times of the joints' samples [s], and of the other sensors without their own
    q : (k, n) positions of the joints in the order of the robot [rad, or m if prismatic]
    tau : (k, n) torques [N m, or N if prismatic]; None: the joints have no torque sensors
    gyro_rad_s : (l, 3) angular rate of the base in the axes of the inertial unit
    specific_force_m_s2 : (l, 3) in the same axes; at rest on the ground it points up
    q_NB_xyzw : (m, 4) attitude: the quaternion that takes components in B to inertial ones
    t_imu_s, t_attitude_s : (l,), (m,) times of these sensors on the same clock; None: `t_s`

    Raises
    ------
    ConfigError that names the array, its shape and the shape it must have.
    """

    t_s: ArrayLike
    q: ArrayLike
    tau: ArrayLike | None = None
    gyro_rad_s: ArrayLike | None = None
    specific_force_m_s2: ArrayLike | None = None
    q_NB_xyzw: ArrayLike | None = None
    t_imu_s: ArrayLike | None = None
    t_attitude_s: ArrayLike | None = None

    def __post_init__(self) -> None:
        held = {own.name: getattr(self, own.name) for own in fields(self)}
        for name, values in held.items():
            if values is not None:
                object.__setattr__(self, name, _numbers(name, values))
        if self.specific_force_m_s2 is not None and self.gyro_rad_s is None:
            raise ConfigError("samples: specific_force_m_s2: given without gyro_rad_s")
        for name, time in (
            ("q", "t_s"),
            ("tau", "t_s"),
            ("gyro_rad_s", "t_imu_s"),
            ("specific_force_m_s2", "t_imu_s"),
            ("q_NB_xyzw", "t_attitude_s"),
        ):
            if (own := self.array(name)) is None:
                continue
            clock = "t_s" if self.array(time) is None else time
            if len(own) != (rows := len(self._times(time))):
                words = f"{len(own)} rows, and {clock} has {rows}; must be as many"
                raise ConfigError(f"samples: {name}: {words}")

    def array(self, name: str) -> FloatArray | None:
        """Return the array `name`; None if it was not given."""
        found: FloatArray | None = getattr(self, name)
        return found

    def _times(self, name: str) -> FloatArray:
        found = self.array(name)
        return np.asarray(self.t_s if found is None else found, np.float64)

    def recorded(self, model: RobotModel) -> Recorded:
        """Return rates, sizes and noise of the sensors, as `fsw init --recording` finds them.

        Raises
        ------
        ConfigError if the arrays are not those of this robot.
        """
        self._refuse_width(model.joint_names)
        q, tau = np.asarray(self.q), self.array("tau")
        gyro, force, turn = map(self.array, WIDTHS)
        t_imu_s, t_turn_s = self._times("t_imu_s"), self._times("t_attitude_s")
        for name in ("t_s", "t_imu_s"):
            rate_hz = rate_of(self._times(name))
            if self.array(name) is not None and rate_hz < LEAST_HZ:
                words = f"{rate_hz:.3g} Hz; must be seconds, at {LEAST_HZ:g} Hz or more"
                raise ConfigError(f"samples: {name}: {words}")
        return Recorded(
            rate_hz=rate_of(self._times("t_s")),
            imu_rate_hz=0.0 if gyro is None else rate_of(t_imu_s),
            tracker_rate_hz=0.0 if turn is None else rate_of(t_turn_s),
            has_torque=tau is not None,
            joints=sizes_of(self._times("t_s"), q, tau, model.kinds()),
            gyro_noise_rad_s=noise_of(t_imu_s, gyro),
            acc_noise_m_s2=noise_of(t_imu_s, force),
            turn_noise_rad=noise_of_turns(t_turn_s, turn),
        )

    def write(self, config: Config, out: Path) -> list[str]:
        """Write a recording of the arrays; return a line for each sensor about what was read.

        Raises
        ------
        ConfigError if the arrays are not those of the configuration, or cannot be used.
        """
        self._refuse_width([joint.name for joint in config.joints])
        self._refuse_other_sensors(config)
        columns: dict[str, FloatArray] = {
            own.name: values for own in fields(self) if (values := self.array(own.name)) is not None
        }
        units = [SI[joint.kind] for joint in config.joints]
        mapping = Mapping.model_validate(self._mapping(units))
        table = Table(NAME, Columns(values=columns))
        channels = list(sampled_channels(config, mapping, Path(), table))
        write(config, channels, out)
        return [f"{channel.topic.rsplit('/', 1)[1]}: {channel.text}" for channel in channels]

    def _mapping(self, units: Sequence[tuple[str, str]]) -> Values[str, Any]:
        """Return the mapping of the arrays; `units` are those of each joint."""

        def timed(name: str) -> dict[str, Any]:
            column = "t_s" if self.array(name) is None else name
            return {"time": {"column": column, "unit": "s"}}

        def quantity(name: str, unit: object) -> dict[str, Any]:
            return {"columns": name, "unit": unit}

        joints = timed("t_s") | {"position": quantity("q", [unit for unit, _ in units])}
        if self.tau is not None:
            joints["torque"] = quantity("tau", [unit for _, unit in units])
        sections = {"joints": joints}
        if self.gyro_rad_s is not None:
            sections["imu"] = timed("t_imu_s") | {"rate": quantity("gyro_rad_s", "rad/s")}
        if self.specific_force_m_s2 is not None:
            sections["imu"]["specific_force"] = quantity("specific_force_m_s2", "m/s2")
        if self.q_NB_xyzw is not None:
            turn = quantity("q_NB_xyzw", "1") | {"order": "xyzw"}
            sections["star_tracker"] = timed("t_attitude_s") | {"quaternion": turn}
        return sections

    def _refuse_width(self, names: Sequence[str]) -> None:
        for name in ("q", "tau"):
            own = self.array(name)
            if own is not None and own.shape[1] != len(names):
                raise ConfigError(
                    f"samples: {name}: {own.shape[1]} columns; must be {len(names)}, one for each "
                    f"of {', '.join(names)}"
                )

    def _refuse_other_sensors(self, config: Config) -> None:
        """Raise ConfigError for a sensor of the robot without array, or the other way round."""
        sensed = any(joint.torque != "none" for joint in config.joints)
        for name, key, is_there in (
            ("tau", "joints[].torque", sensed),
            ("gyro_rad_s", "imu", config.imu.present),
            ("q_NB_xyzw", "star_tracker", config.star_tracker is not None),
        ):
            if is_there and self.array(name) is None:
                raise ConfigError(f"samples: {name}: missing; {config.name} has {key}")
            if not is_there and self.array(name) is not None:
                raise ConfigError(f"samples: {name}: given, and {config.name} has no {key}")


def _numbers(name: str, values: ArrayLike) -> FloatArray:
    """Return an array of the shape that its name has, which nobody can change."""
    try:
        given: Any = np.ma.asarray(values)
        is_real = given.dtype.kind not in "bc"
        found: FloatArray = np.array(given.real.astype(np.float64).filled(np.nan))
    except (TypeError, ValueError) as error:
        raise ConfigError(f"samples: {name}: {brief(values)} must be numbers") from error
    if not is_real:
        raise ConfigError(f"samples: {name}: {given.dtype}; must be real numbers")
    axes = 1 if name in TIMES else 2
    width = WIDTHS.get(name)
    if found.ndim != axes or len(found) < LEAST or (width and found.shape[1] != width):
        columns = "" if axes == 1 else f", {width or 'one for each joint'}"
        words = f"({LEAST} rows or more{columns})"
        turned = found.ndim == axes == 2 and found.shape[0] < LEAST <= found.shape[1]
        words += "; is it transposed?" * turned
        raise ConfigError(f"samples: {name}: of shape {found.shape}; must be {words}")
    if axes == 1 and (rising := int(np.count_nonzero(np.diff(found) > 0.0))) < LEAST - 1:
        words = f"{rising} of {len(found) - 1} steps go forward; must be at least {LEAST - 1}"
        raise ConfigError(f"samples: {name}: {words}")
    found.setflags(write=False)
    return found
