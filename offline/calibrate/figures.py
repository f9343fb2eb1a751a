"""Figures of a calibration with value, 1 sigma and verdict; their table and overlay."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from fsw.config import Config
from fsw.estimators.conditioning.rotation import rotation_from_xyzw
from fsw.estimators.measurement.mounting import LEANING
from fsw.estimators.model.state_groups import BY_NAME
from fsw.estimators.parameter_verdicts import DATA_GAIN, MEASURED, PRIOR
from fsw.messages import FloatArray

DELAY_KEYS = {"gyro": "gyro_group_delay_s", "accelerometer": "acc_group_delay_s"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One found value minus the configured one; biases in S of the unit, mounting in B."""

    kind: str  # a group of states, or delay
    which: str  # joint, axis or sensor
    value: float
    sigma: float
    known: float  # 1 sigma of the configured value; inf: the configuration states none
    refused: str = ""  # reason not to use the value in spite of a small sigma

    @property
    def name(self) -> str:
        """Kind and place, such as `gyro_bias.x`."""
        return f"{self.kind}.{self.which}"

    @property
    def unit(self) -> str:
        """The unit of value and sigma; 1 for a ratio."""
        return "s" if self.kind == "delay" else BY_NAME[self.kind].unit or "1"

    @property
    def verdict(self) -> str:
        """Whether the value is measured or prior-dominated; if refused, the reason."""
        if self.refused:
            return self.refused
        shown = self.sigma**2 * (1.0 + DATA_GAIN) < self.known**2
        return MEASURED if shown else PRIOR

    @property
    def measured(self) -> bool:
        """Whether the figure goes into the overlay."""
        return self.verdict == MEASURED


def stated(sigma: float) -> float:
    """Return a configured sigma; inf for 0, which says nothing about the error."""
    return sigma if sigma > 0.0 else inf


def in_axes(
    kind: str, mean: FloatArray, covariance: FloatArray, R: FloatArray, known: float
) -> list[Figure]:
    """Return three figures of the vector R @ mean; mean (3,), covariance (3, 3), R (3, 3)."""
    values, sigmas = R @ mean, np.sqrt(np.diag(R @ covariance @ R.T))
    return [
        Figure(kind=kind, which=axis, value=float(v), sigma=float(s), known=known)
        for axis, v, s in zip(BY_NAME[kind].axes, values, sigmas, strict=True)
    ]


def table(figures: Sequence[Figure]) -> list[str]:
    """Return the figures as aligned lines."""
    width = max(len(figure.name) for figure in figures)
    return [
        f"{figure.name:<{width}} {figure.value:>+12.5g} +- {figure.sigma:<8.2g} "
        f"{figure.unit:<5} {figure.verdict}{_words(figure)}"
        for figure in figures
    ]


def _words(figure: Figure) -> str:
    if figure.verdict != PRIOR:
        return ""
    return f", not used: +- {figure.known:.2g} is configured"


def to_json(figures: Iterable[Figure]) -> list[dict[str, Any]]:
    """Return the figures as plain values."""
    return [
        {
            "name": figure.name,
            "value": figure.value,
            "sigma": figure.sigma,
            "unit": figure.unit,
            "verdict": figure.verdict,
        }
        for figure in figures
    ]


def overlay_values(config: Config, figures: Sequence[Figure]) -> dict[str, Any]:
    """Return the sections and keys that the measured figures change; empty: nothing measured."""
    used = {figure.name: figure for figure in figures if figure.measured}
    sections = {
        "joints": _joints(config, used),
        "imu": _imu(config, used),
        "star_tracker": _star_tracker(config, used),
    }
    return {key: values for key, values in sections.items() if values}


def overlay_text(values: dict[str, Any], comments: Sequence[str]) -> str:
    """Return the YAML text of an overlay file, with comments at its head."""
    head = "".join(f"# {line}".rstrip() + "\n" for line in comments)
    return head + yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=100)


def _joints(config: Config, used: dict[str, Figure]) -> list[dict[str, Any]]:
    """Return the joints that change; measured torque = (true torque) (1 + scale) + offset."""
    found = []
    for joint in config.joints:
        offset = used.get(f"torque_offset.{joint.name}")
        scale = used.get(f"torque_scale.{joint.name}")
        delay = used.get(f"torque_delay.{joint.name}")
        if offset is None and scale is None and delay is None:
            continue
        values: dict[str, Any] = {"name": joint.name}
        if delay is not None:
            values["torque_delay_s"] = joint.torque_delay_s + delay.value
            values["torque_delay_sigma_s"] = delay.sigma
        ratio = 1.0 + (scale.value if scale else 0.0)
        if scale is not None:
            values["torque_gain"] = joint.torque_gain / ratio
            values["torque_scale_sigma_ratio"] = scale.sigma
        total = joint.torque_offset_nm + (offset.value if offset else 0.0)
        values["torque_offset_nm"] = total / ratio
        if offset is not None:
            values["torque_offset_sigma_nm"] = offset.sigma
        found.append(joint.named(values))
    return found


def _imu(config: Config, used: dict[str, Figure]) -> dict[str, Any]:
    imu, values = config.imu, dict[str, Any]()
    biases = (("gyro_bias", imu.gyro_bias_S_rad_s), ("acc_bias", imu.acc_bias_S_m_s2))
    for (kind, before), key in zip(biases, ("gyro_bias_S_rad_s", "acc_bias_S_m_s2"), strict=True):
        if (change := _vector(kind, used)) is not None:
            if kind == "gyro_bias":  # `change` is of readings after the matrix
                change = np.linalg.solve(np.array(imu.gyro_matrix), change)
            values[key] = (np.array(before) + change).tolist()
            values |= _sigma(kind, used)
    mounting = {}
    if (change := _vector("imu_place", used)) is not None:
        mounting["p_BS_m"] = (np.array(imu.mounting.p_BS_m) + change).tolist()
        values |= _sigma("imu_place", used)
    if (change := _vector("imu_angle", used)) is not None:
        turned = Rotation.from_rotvec(change) * Rotation.from_quat(imu.mounting.q_BS_xyzw)
        mounting["q_BS_xyzw"] = turned.as_quat().tolist()
        values |= _sigma("imu_angle", used)
    scale, axes = (_vector(kind, used) for kind in ("gyro_scale", "gyro_axes"))
    if scale is not None or axes is not None:
        E = np.zeros((3, 3)) if scale is None else np.diag(scale)
        if axes is not None:
            E[LEANING] = E[LEANING[::-1]] = axes
        values["gyro_matrix"] = ((np.eye(3) + E) @ np.array(imu.gyro_matrix)).tolist()
        values |= _sigma("gyro_scale", used) | _sigma("gyro_axes", used)
    for sensor, key in DELAY_KEYS.items():
        if (delay := used.get(f"delay.{sensor}")) is not None:
            values[key] = getattr(imu, key) + delay.value
    return values | ({"mounting": mounting} if mounting else {})


def _star_tracker(config: Config, used: dict[str, Figure]) -> dict[str, Any]:
    delay = used.get("delay.star_tracker")
    if config.star_tracker is None or delay is None:
        return {}
    return {"latency_s": config.star_tracker.latency_s + delay.value}


def _vector(kind: str, used: dict[str, Figure]) -> FloatArray | None:
    """Return the change (3,), zero along axes not measured; None: no axis is measured."""
    own = [used.get(f"{kind}.{axis}") for axis in BY_NAME[kind].axes]
    return np.array([f.value if f else 0.0 for f in own]) if any(own) else None


def _sigma(kind: str, used: dict[str, Figure]) -> dict[str, float]:
    """Return key and largest sigma of the three axes; empty unless all axes are measured."""
    own = [used.get(f"{kind}.{axis}") for axis in BY_NAME[kind].axes]
    return {BY_NAME[kind].field: max(f.sigma for f in own if f)} if all(own) else {}


def sensor_axes(config: Config) -> FloatArray:
    """Return R_SB (3, 3), from axes of B to axes of the inertial unit S."""
    return rotation_from_xyzw(np.array(config.imu.mounting.q_BS_xyzw)).T
