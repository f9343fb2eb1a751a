"""Reaction wheels: what is in doubt of each, what they report, and the momentum they carry.

A wheel k turns with the measured speed relative to the base: h_k = J_k speed_k, see `carried`.
"""

from collections.abc import Mapping

import numpy as np

from fsw.config import Config, WheelConfig
from fsw.estimators.effects.carried import Carrier
from fsw.estimators.effects.device import Device, Driven, Samples
from fsw.estimators.model.state_group import StateGroup, per_part
from fsw.estimators.wheel_motion import WheelsMotion
from fsw.messages import FloatArray, IntArray

SCALE = StateGroup(  # relative error of each wheel's axial inertia
    name="wheel_scale",
    effect="inertia of wheels",
    unit="",
    key="wheels[].inertia_sigma_ratio",
    prior=per_part("wheels", "inertia_sigma_ratio"),
    is_calibration=True,
    mistake="axial inertia of wheels",
)
DELAY = StateGroup(  # true delay less the configured one
    name="wheel_delay",
    effect="delay of wheels",
    unit="s",
    key="wheels[].delay_sigma_s",
    prior=per_part("wheels", "delay_sigma_s"),
    is_calibration=True,
)


def _speeding_up(own: WheelConfig, t_s: FloatArray, _window_s: float) -> FloatArray:
    gained = 0.1 * own.torque_limit_nm * t_s / own.inertia_kg_m2
    return np.stack([gained, np.full(len(t_s), np.nan)], axis=1)


def _at_rest(
    own: WheelConfig, _i: int, t_ns: IntArray, _span_ns: tuple[int, int], _driven: Driven
) -> Samples:
    still = np.zeros(len(t_ns))
    return t_ns, np.stack([still, np.where(own.torque == "none", np.nan, still)], axis=1)


WHEELS = Device(
    section="wheels",
    gentle=_speeding_up,
    along=_at_rest,
    follow=WheelsMotion,
    unplanned=lambda _: "wheels: counted as if they stood still relative to the base",
)


def carrier(config: Config, places: Mapping[str, slice]) -> Carrier:
    """Return the wheels of a configuration, for a state whose groups are at `places`."""
    axes = np.array([wheel.axis_B for wheel in config.wheels]).reshape(-1, 3).T
    states = places.get(SCALE.name), places.get(DELAY.name)
    return Carrier(axes, *states, config.estimator.window_s)


def words(config: Config) -> list[str]:
    """Return a line for each wheel, and a line on what the model does not contain."""
    lines = []
    for wheel in config.wheels:
        axis = " ".join(f"{x:.4g}" for x in wheel.axis_B)
        most = wheel.inertia_kg_m2 * wheel.speed_limit_rad_s
        torque = "speed" if wheel.torque == "none" else "speed and motor torque"
        lines.append(
            f"{wheel.name}: axis [{axis}], {wheel.inertia_kg_m2:.4g} kg m^2 "
            f"+- {wheel.inertia_sigma_ratio:.1%}, {torque} at {wheel.rate_hz:g} Hz, at most "
            f"{most:.4g} N m s and {wheel.torque_limit_nm:.4g} N m"
        )
    return [*lines, "mass and locked inertia of every wheel belong to base; imbalance is noise"]
