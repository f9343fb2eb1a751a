"""What a recorded arm declares: its recordings, its URDF and what its owner knows of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence.hardware.data_set import DataSet

FloatArray = NDArray[np.float64]
JointKeys = dict[str, float | str]  # of one joint of an overlay
Read = Callable[[DataSet, str], bytes]  # the bytes of one file of a data set


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Angles and torques of all joints at common times, as the owner's log has them."""

    t_s: FloatArray  # (k,) times
    q_rad: FloatArray  # (k, n)
    tau: FloatArray  # (k, n) torques [N m], or currents [A] that the mapping scales

    def part(self, start: float, stop: float) -> Motion:
        """Return the samples between two shares of their number, from 0 to 1."""
        own = slice(round(start * len(self.t_s)), round(stop * len(self.t_s)))
        return Motion(self.t_s[own], self.q_rad[own], self.tau[own])

    def write(self, path: Path, joints: Sequence[str]) -> None:
        """Write a CSV file with the columns t_s, q_JOINT [rad] and tau_JOINT."""
        names = [f"{kind}_{joint}" for kind in ("q", "tau") for joint in joints]
        table = np.column_stack([self.t_s, self.q_rad, self.tau])
        header = ",".join(["t_s", *names])
        np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One recording of an arm.

    A run that is held out is used for no choice of a method or of a value: it is judged once, at
    the end.
    """

    name: str
    payload_kg: float  # 0: the flange is empty
    motion: Callable[[Read], Motion]
    empty: str | None = None  # the run of the same arm that `--reference` gets
    alone: bool = True  # whether it is judged without a reference too
    held_out: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Arm:
    """An arm on a bench: everything that `hil hardware` needs to know of it."""

    name: str
    data_sets: Sequence[DataSet]
    urdf: Callable[[Read], bytes]
    tool: str  # flag --tool of `fsw init`
    guess_kg: float  # flag --target-mass-kg
    rate_hz: float
    joints: Sequence[str]
    runs: Sequence[Run]
    configuration: Callable[[], str] | None = None  # None: `fsw init` writes it
    sensor: str = "arm_sensor"  # flag --torque
    torque: Mapping[str, Any] = field(default_factory=dict)  # keys of the mapping: scale, sign
    overlay: Mapping[str, Any] = field(default_factory=dict)  # what its owner adds: "best"
    residual_bound_nm: float = float("nan")  # of held-out torques, where another work states one


def motor_current(limits_nm: Mapping[str, float], angle_noise_rad: float) -> list[JointKeys]:
    """Return the overlay of joints whose torque is a motor's current, by their largest torques.

    Friction and rotor inertia have the wide priors of `torque: motor_current`.
    """
    return [
        {
            "name": joint,
            "torque": "motor_current",
            "torque_noise_nm": 0.004 * limit,
            "torque_offset_sigma_nm": 0.02 * limit,
            "torque_scale_sigma_ratio": 0.2,
            "torque_model_sigma_nm": 0.01 * limit,
            "position_noise_rad": angle_noise_rad,
            "friction_speed_rad_s": 0.03,
        }
        for joint, limit in limits_nm.items()
    ]


def friction(limits_nm: Mapping[str, float], angle_noise_rad: float) -> list[JointKeys]:
    """Return the overlay of link-side sensors with the friction of seals, bearings and cables."""
    return [
        {
            "name": joint,
            "position_noise_rad": angle_noise_rad,
            "torque_offset_sigma_nm": 0.05 * limit,
            "torque_scale_sigma_ratio": 0.02,
            "friction_coulomb_sigma_nm": 0.05 * limit,
            "friction_viscous_sigma_nms_rad": 0.05 * limit,
            "friction_speed_rad_s": 0.03,
        }
        for joint, limit in limits_nm.items()
    ]
