"""A candump of foreign drives in a motion of the bench, and the configuration that fits it."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from evidence.mistakes.wires import describe, frames, write_candump
from hil.run.bench import Setup

RATE_HZ = 100.0
EPOCH_S = 1_760_000_000
RUBBING_NM, SLOW_RAD_S, ROTOR_KG_M2 = 3.0, 0.02, 1.0
SENSORS = ("imu", "star_tracker")


def candump(
    setup: Setup,
    path: Path,
    *,
    rate_hz: float = RATE_HZ,
    lost: float = 0.0,
    late_s: float = 0.0,
    is_motor: bool = False,
    seed: int = 5,
) -> Path:
    """Write the log of the motion.

    Parameters
    ----------
    lost : share of frames that are missing
    late_s : age of the values in a frame
    is_motor : the torques are those of motors, with friction and the inertia of a rotor
    """
    rng = np.random.default_rng(seed)
    sent: list[tuple[float, str]] = []
    for k, joint in enumerate(setup.config.joints):
        t_s = np.arange(rng.uniform(0.0, 1.0 / rate_hz), setup.history.end_s, 1.0 / rate_hz)
        state = setup.history.at(np.maximum(t_s - late_s, 0.0))
        tau = state.tau[:, k]
        if is_motor:
            tau = tau + RUBBING_NM * np.tanh(state.qd[:, k] / SLOW_RAD_S)
            tau = tau + ROTOR_KG_M2 * state.qdd[:, k]
        tau = tau + rng.normal(0.0, joint.torque_offset_sigma_nm)
        tau = tau + rng.normal(0.0, joint.torque_noise_nm, len(t_s))
        q = joint.sign * (state.q[:, k] + joint.zero_offset_rad)
        sent += [own for own in frames(k, t_s, q, joint.sign * tau, rng) if rng.random() >= lost]
    write_candump(path, sent, EPOCH_S)
    return path


def described(setup: Setup, *, rate_hz: float = RATE_HZ, clamped: bool = True) -> dict[str, Any]:
    """Return the document of the configuration that reads such a log."""
    data: dict[str, Any] = yaml.safe_load(setup.config_path.read_text())
    data["robot"]["urdf"] = str(setup.config_path.parent / data["robot"]["urdf"])
    if clamped:
        for section in SENSORS:
            data.pop(section, None)
    describe(data, rate_hz)
    return data
