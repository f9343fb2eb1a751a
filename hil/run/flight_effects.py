"""Flight configuration of wheels, thrusters and modes, with errors drawn from their sigmas."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from hil.world.inertia import FloatArray
from hil.world.scenario import Scenario, ScenarioError
from hil.world.sensor_config import ThrusterSensorConfig, WheelSensorConfig
from hil.world.sensors import generator
from hil.world.springs import Panel, Sprung
from hil.world.thrusters import ThrusterSystem
from hil.world.wheels import WheelSystem


def draws(
    seed: int | None, device: str, shape: tuple[int, ...], index: int = 0, stream: int = 0
) -> FloatArray:
    """Return standard normal draws for the errors of declared values; zeros if seed is None."""
    if seed is None:
        return np.zeros(shape)
    return np.asarray(generator(seed, device, index, stream).standard_normal(shape))


def wheel_sections(
    system: WheelSystem, sensors: WheelSensorConfig, seed: int | None
) -> list[dict[str, Any]]:
    """Return the section `wheels`; the error of each inertia is drawn from its sigma."""
    if len(sensors.nodes) != len(system.rotors):
        raise ScenarioError(
            f"sensors.wheels.nodes: {len(sensors.nodes)} nodes for {len(system.rotors)} wheels"
        )
    off = draws(seed, "wheel", (len(system.rotors),), len(system.rotors))
    torque: dict[str, Any] = {"torque": "none"}
    if sensors.torque_used:
        torque = {"torque": "measured", "torque_noise_nm": sensors.torque_noise_nm}
    return [
        {
            "name": f"wheel{k + 1}",
            "bus": node.bus,
            "node_id": node.node_id,
            "rate_hz": sensors.rate_hz,
            "axis_B": rotor.unit.tolist(),
            "inertia_kg_m2": rotor.inertia_kg_m2
            / (1.0 + system.inertia_sigma_ratio * float(off[k])),
            "inertia_sigma_ratio": system.inertia_sigma_ratio,
            "speed_limit_rad_s": 1.1 * system.speed_limit_rad_s,
            "speed_noise_rad_s": sensors.speed_noise_rad_s,
            "torque_limit_nm": 1.1 * system.torque_limit_nm,
            **torque,
        }
        for k, (node, rotor) in enumerate(zip(sensors.nodes, system.rotors, strict=True))
    ]


def thruster_sections(
    system: ThrusterSystem, sensors: ThrusterSensorConfig, seed: int | None
) -> list[dict[str, Any]]:
    """Return the section `thrusters`; force, delay and rise time get errors from their sigmas."""
    off = draws(seed, "thruster", (4, len(system.jets)))
    force = system.force_sigma_ratio * math.sqrt(0.5) * (off[0, 0] + off[1])
    delay_s = np.maximum(system.delay_s - system.delay_sigma_s * off[2], 0.0)
    rise_s = np.maximum(system.rise_s - system.rise_sigma_s * off[3], 0.1 * system.rise_s)
    return [
        {
            "name": f"thruster{k + 1}",
            "bus": sensors.bus,
            "node_id": sensors.node_id,
            "valve": k,
            "rate_hz": sensors.rate_hz,
            "p_B_m": list(jet.place_m),
            "direction_B": jet.unit.tolist(),
            "force_n": jet.force_n / (1.0 + float(force[k])),
            "force_sigma_ratio": system.force_sigma_ratio,
            "delay_s": float(delay_s[k]),
            "delay_sigma_s": system.delay_sigma_s,
            "rise_s": float(rise_s[k]),
            "rise_sigma_s": system.rise_sigma_s,
        }
        for k, jet in enumerate(system.jets)
    ]


def mode_sections(
    scenario: Scenario, told: Mapping[str, Any], seed: int | None
) -> list[dict[str, Any]]:
    """Return the section `modes`; mass, frequency and damping get errors from their sigmas."""
    parts: tuple[Sprung, ...] = (*scenario.slosh, *scenario.panels)
    kinds = ("mass", "frequency", "damping")
    sigma = np.array([told[f"{kind}_sigma_ratio"] for kind in kinds])
    off = draws(seed, "mode", (len(parts), len(kinds)), len(parts)) * sigma
    modes = []
    for k, (part, (mass, frequency, damping)) in enumerate(zip(parts, off.tolist(), strict=True)):
        mode: dict[str, Any] = {
            "name": f"mode{k + 1}",
            "kind": "slosh",
            "p_B_m": list(part.place_m),
            "axes_B": [(np.array(axis) / np.linalg.norm(axis)).tolist() for axis in part.axes],
            "mass_kg": part.mass_kg / (1.0 + mass),
            "frequency_hz": part.frequency_hz * math.exp(-frequency),
            "damping_ratio": part.damping_ratio * math.exp(-damping),
            **{f"{kind}_sigma_ratio": told[f"{kind}_sigma_ratio"] for kind in kinds},
        }
        if isinstance(part, Panel):
            inertia = [value / (1.0 + mass) for value in part.inertia_kg_m2]
            mode |= {"kind": "panel", "com_m": list(part.com_m), "inertia_kg_m2": inertia}
            mode["amplitude_rad"] = told["amplitude_rad"]
        else:
            mode["amplitude_m"] = told["amplitude_m"]
        modes.append(mode)
    return modes
