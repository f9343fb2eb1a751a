"""Text of a configuration that `fsw init` writes: bodies, joints, sensors, windows."""

import argparse
from collections.abc import Iterable, Mapping
from math import ceil, inf
from typing import Any

import yaml

from fsw.checks import budget
from fsw.checks.configuration import HIGH_LOAD
from fsw.checks.robot import MOST_EFFORT_NM, MOST_SPEED_RAD_S
from fsw.config.base import SMALLEST
from fsw.config.feed import SAMPLES
from fsw.config.joints import linear
from fsw.config.processing import EstimatorConfig
from fsw.errors import ConfigError
from fsw.estimators.conditioning.polynomial import EXTRA_DEGREE
from fsw.estimators.model.robot import RobotModel
from offline.init.answers import Ask, angles, one_of, three
from offline.init.devices import device, library, trust
from offline.init.noise import Limits
from offline.init.recording import Recorded

UNKNOWN_EFFORT_NM, UNKNOWN_SPEED_RAD_S = 1e3, 10.0  # of a joint whose <limit> is a placeholder
LEAST_NOISE_NM, LEAST_NOISE_RAD = 3e-3, 1.2e-7  # rounding of torque and position in a TPDO1
SPARE = 1.2  # ratio of a limit to the largest value of a recording
BITRATE = 1_000_000
LEAST_SIGMA = 1e-9  # of an inertia, by the configuration
MOST_NODE = 127
NO_TURN = "0 0 0"  # stands in for a place or a turn that is missing


def word(text: str) -> str:
    """Return a name as a YAML scalar, quoted where YAML would read it as another type."""
    return yaml.safe_dump(text, width=inf, allow_unicode=True).removesuffix("\n...\n").strip()


def numbers(values: Iterable[float]) -> str:
    """Return numbers as a YAML list."""
    return "[" + ", ".join(f"{float(value):.6g}" for value in values) + "]"


def body_lines(
    name: str, mass: float, com: Iterable[float], inertia: Iterable[float], reach: float
) -> list[str]:
    """Return the section of an unknown body with a wide prior."""
    own = [float(value) for value in inertia]
    largest = max(own[0], own[3], own[5])
    spread = [0.5 * own[k] if k in (0, 3, 5) else 0.25 * largest for k in range(6)]
    spread = [max(sigma, LEAST_SIGMA) for sigma in spread]
    return [
        f"  {name}:  # CHECK the prior: about right; half of it may be wrong, as sigma says",
        f"    mass_kg: {mass:.6g}",
        f"    com_m: {numbers(com)}  # in the frame of the body",
        f"    inertia_kg_m2: {numbers(own)}  # xx xy xz yy yz zz",
        "    sigma:",
        f"      mass_kg: {0.5 * mass:.6g}",
        f"      com_m: {numbers([0.5 * reach] * 3)}",
        f"      inertia_kg_m2: {numbers(spread)}",
    ]


def figures(device: Mapping[str, Any]) -> list[str]:
    """Return the lines of a device's figures."""
    words = ("title", "source", "verified", "driver")
    return [f"  {key}: {value}" for key, value in device.items() if key not in words]


def limit(given: float, most: float, seen: float, otherwise: float) -> str:
    """Return a limit with a comment.

    Parameters
    ----------
    given : of the URDF; used if it is positive, at most `most`, and not exceeded by `seen`
    seen : largest value of a recording; 0: none
    otherwise : used if neither of them can be
    """
    is_given = 0.0 < given <= most
    if is_given and seen <= given:
        return f"{given:g}  # of the URDF"
    if seen:
        above = f"above the {given:g} of the URDF" if is_given else "the URDF has none"
        return f"{SPARE * seen:.4g}  # CHECK the recording has up to {seen:.4g}, {above}"
    return f"{otherwise:g}  # CHECK the URDF has {given:g}, no limit of a joint"


def joints_per_bus(rate_hz: float) -> int:
    """Return how many joints a bus carries at a rate without a warning on its load.

    Raises
    ------
    ConfigError if it carries none.
    """
    sync_s = budget.classic_frame_s(budget.SYNC_BYTES, BITRATE)
    joint_s = budget.classic_frame_s(budget.TPDO1_BYTES, BITRATE)
    joint_s += budget.classic_frame_s(budget.TPDO2_BYTES, BITRATE) / budget.TPDO2_DIVIDER
    count = int((HIGH_LOAD / rate_hz - sync_s) / joint_s)
    if count < 1:
        most_hz = HIGH_LOAD / (sync_s + joint_s)
        raise ConfigError(
            f"--rate-hz: {rate_hz:g} is more than a bus of {BITRATE} bit/s carries for one joint; "
            f"must be at most {most_hz:.0f}"
        )
    return count


def links_lines(torque: Mapping[str, Any]) -> list[str]:
    """Return the line on the doubt of the links' masses, if a device's figures have one."""
    key = "links_sigma_ratio"
    words = "CHECK a guess for the masses of a URDF; less for those of a drawing"
    return [f"  {key}: {torque[key]:g}  # {words}"] if key in torque else []


def bus_lines(rate_hz: float, joints: int, found: Recorded | None) -> tuple[list[str], int]:
    """Return the section `buses`, and the number of joints on each bus but the last."""
    if found is not None and found.wires is not None:
        own = [f"    {line}" for line in found.wires.bus]
        lines = [f"  - name: {word(found.wires.name)}  # recordings: /can/{found.wires.name}", *own]
        return ["", "buses:", *lines, f"    rate_hz: {rate_hz!r}  # CHECK"], joints
    if found is not None and found.is_table:
        lines = ["  - name: arm", "    interface: samples  # decoded by the recorder"]
        return ["", "buses:", *lines, f"    rate_hz: {rate_hz!r}  # of the recording"], joints
    # a log is of one bus, which has carried it
    each = joints if found is not None else min(joints, joints_per_bus(rate_hz))
    lines = ["", "buses:"]
    for k in range(ceil(joints / each)):
        name = bus_name(k)
        lines += [
            f"  - name: {name}  # recordings: /can/{name}",
            "    interface: socketcan  # CHECK any of python-can's",
            f"    channel: can{k}  # CHECK",
            *([] if found is not None else [f"    bitrate: {BITRATE}  # CHECK"]),
            f"    rate_hz: {rate_hz!r}",
        ]
    return lines, each


def bus_name(number: int) -> str:
    """Return the name of a bus, counted from 0."""
    return "arm" if number == 0 else f"arm{number + 1}"


def joint_lines(
    arguments: argparse.Namespace, model: RobotModel, each: int, found: Recorded | None
) -> list[str]:
    """Return the section `joints`; `each`: joints on a bus."""
    encoder, torque = device("encoder", arguments.encoder), device("torque", arguments.torque)
    nodes = [arguments.first_node + k for k in range(model.n)]
    nodes = list(found.nodes) if found is not None and found.nodes else nodes
    if not 1 <= min(nodes) <= max(nodes) <= MOST_NODE:
        raise ConfigError(
            f"--first-node: 0x{arguments.first_node:02x} and {model.n} joints end at node "
            f"{max(nodes)}; nodes are 1 to {MOST_NODE}"
        )
    lines = [
        "",
        f"# encoder: {encoder['title']}; {trust(encoder)}",
        f"# torque: {torque['title']}; {trust(torque)}",
        "joints:",
    ]
    for k, (name, kind) in enumerate(zip(model.joint_names, model.kinds(), strict=True)):
        seen = found.joints[k] if found is not None and found.joints else Limits()
        effort, speed = (
            float(limits[6 + k]) for limits in (model.model.effortLimit, model.model.velocityLimit)
        )
        efforts = limit(effort, MOST_EFFORT_NM, seen.torque_nm, UNKNOWN_EFFORT_NM)
        size = float(efforts.split()[0])
        noise = max(torque["noise_ratio"] * size, LEAST_NOISE_NM)
        position_noise = f"{encoder['position_noise_rad']:g}"
        if seen.position_noise_rad:
            position_noise = f"{max(seen.position_noise_rad, LEAST_NOISE_RAD):.3g}  # CHECK"
        measured = {
            **{key: f"{torque[key]}" for key in ("torque",) if key in torque},
            "torque_limit_nm": efforts,
            # filtered torques show too little noise; those of a motor's current may be amperes
            "torque_noise_nm": f"{max(seen.torque_noise_nm, noise):.3g}  # CHECK"
            if seen.torque_noise_nm > 0.0 and "torque" not in torque
            else f"{noise:.3g}",
            "torque_offset_sigma_nm": f"{torque['offset_ratio'] * size:.3g}",
            "torque_scale_sigma_ratio": f"{torque['torque_scale_sigma_ratio']:g}",
            **_friction(torque, size),
        }
        if found is not None and not found.has_torque:
            measured = {"torque": "none  # CHECK none was found"}
        own = {
            "sign": "1  # CHECK -1: the node counts against the URDF's axis",
            "zero_offset_rad": "0.0",
            "speed_limit_rad_s": limit(
                speed, MOST_SPEED_RAD_S, seen.speed_rad_s, UNKNOWN_SPEED_RAD_S
            ),
            **measured,
            "position_noise_rad": position_noise,
        }
        if kind == "prismatic":  # the encoder's numbers count in m, not rad
            own = {"kind": kind} | {linear(key): value for key, value in own.items()}
            if "CHECK" not in position_noise:
                own["position_noise_m"] += "  # CHECK"
        wires = [f"bus: {bus_name(k // each)}", f"node_id: 0x{nodes[k]:02x}  # CHECK"]
        if found is not None and found.is_table:
            wires[1] = "driver: samples"
        if found is not None and found.wires is not None:
            wires = [f"bus: {word(found.wires.name)}", *found.wires.joints[k]]
        lines += [
            f"  - name: {word(name)}",
            *(f"    {line}" for line in wires),
            *(f"    {key}: {value}" for key, value in own.items()),
        ]
    return lines


def _friction(torque: Mapping[str, Any], size: float) -> dict[str, str]:
    """Return the keys of friction and of the model's error that a device's figures give."""
    shares = {
        "friction_coulomb_sigma_nm": "friction_coulomb_ratio",
        "friction_viscous_sigma_nms_rad": "friction_viscous_ratio",
        "torque_model_sigma_nm": "torque_model_ratio",
    }
    found = {
        key: f"{torque[share] * size:.3g}  # CHECK a guess"
        for key, share in shares.items()
        if share in torque
    }
    if "friction_speed_rad_s" in torque:
        found["friction_speed_rad_s"] = f"{torque['friction_speed_rad_s']:g}"
    return found


def imu_lines(ask: Ask, found: Recorded | None) -> tuple[list[str], Mapping[str, Any]]:
    """Return the section `imu`, empty if there is no unit, and the figures of the unit."""
    if found is not None and found.is_table and not found.imu_rate_hz:
        return [], {}
    units = library()["imu"]
    words = f"inertial unit ({', '.join(units)}; none on a clamped base)"
    name = ask("imu", words, one_of((*units, "none")), stand_in=next(iter(units)))
    if name == "none":
        return [], {}
    unit = device("imu", name)
    words = "place of the inertial unit in the root link, x y z [m]"
    place = ask("imu_xyz", words, three, stand_in=NO_TURN)
    words = "roll, pitch, yaw that take its axes to the root link's [rad]"
    turn = ask("imu_rpy", words, angles, stand_in=NO_TURN)
    is_sampled = found is not None and found.is_table
    if found is not None and found.imu_rate_hz:
        seen = {
            "angle_random_walk_rad_sqrt_s": found.gyro_noise_rad_s / found.imu_rate_hz**0.5,
            "velocity_random_walk_m_s_sqrt_s": found.acc_noise_m_s2 / found.imu_rate_hz**0.5,
        }
        unit = unit | {"driver": SAMPLES, "rate_hz": found.imu_rate_hz} | _noises(seen)
    lines = [
        "",
        f"# {unit['title']}; {trust(unit)}",
        "imu:",
        f"  driver: {unit['driver']}",
        *([] if is_sampled else ["  port: /dev/ttyUSB0  # CHECK"]),
        "  mounting:",
        f"    p_BS_m: {numbers(place)}",
        f"    rpy_BS_rad: {numbers(turn)}",
        *figures(unit),
    ]
    return lines, unit


def _noises(seen: Mapping[str, float]) -> dict[str, float]:
    """Return the noises that a recording shows, which replace those of the device."""
    return {key: float(f"{noise:.3g}") for key, noise in seen.items() if noise >= SMALLEST}


def tracker_lines(ask: Ask, found: Recorded | None) -> tuple[list[str], Mapping[str, Any]]:
    """Return the section `star_tracker`, empty if there is none, and the figures of the unit."""
    if found is not None and found.is_table and not found.tracker_rate_hz:
        return [], {}
    name = ask(
        "tracker",
        f"star tracker ({', '.join(library()['star_tracker'])} or none)",
        one_of((*library()["star_tracker"], "none")),
        "none",
    )
    if name == "none":
        return [], {}
    unit = device("star_tracker", name)
    words = "roll, pitch, yaw of the star tracker (boresight z) [rad]"
    turn = ask("tracker_rpy", words, angles, stand_in=NO_TURN)
    if found is not None and found.tracker_rate_hz:
        keys = ("noise_across_rad", "noise_about_rad")
        unit = unit | {"rate_hz": found.tracker_rate_hz}
        unit |= _noises(dict.fromkeys(keys, found.turn_noise_rad))
    lines = [
        "",
        f"# {unit['title']}; {trust(unit)}",
        "star_tracker:",
        f"  driver: {unit['driver']}",
        "  port: /dev/ttyUSB1  # CHECK",
        "  mounting:",
        "    p_BS_m: [0.0, 0.0, 0.0]  # attitude does not depend on it",
        f"    rpy_BS_rad: {numbers(turn)}",
        *figures(unit),
    ]
    return lines, unit


def estimator_lines(
    rate_hz: float, imu: Mapping[str, Any], tracker: Mapping[str, Any]
) -> list[str]:
    """Return the section `estimator` if rates or delays need more than the default window and lag.

    The bounds are those of `fsw.checks.windows`.
    """
    usual = EstimatorConfig()
    terms = [(rate_hz, usual.nodes + EXTRA_DEGREE), (imu.get("rate_hz", inf), usual.nodes)]
    window_s = max(2 * count / usual.min_fill_ratio / hz for hz, count in terms)
    group_s = max(imu.get("gyro_group_delay_s", 0.0), imu.get("acc_group_delay_s", 0.0))
    tracker_s = tracker.get("latency_s", 0.0) + 0.02 * bool(tracker)  # of the line
    slowest_s = max(1.0 / rate_hz, group_s + 1.0 / imu.get("rate_hz", inf) + 0.01, tracker_s)
    lag_s = slowest_s + 1.0 / rate_hz + 0.03  # a tick, and the kernel's queues
    found = {}
    if window_s > usual.window_s:
        found["window_s"] = f"{ceil(20.0 * window_s) / 20.0:g}  # CHECK the least at these rates"
    if lag_s > usual.lag_s:
        found["lag_s"] = f"{ceil(100.0 * lag_s) / 100.0:g}  # of the slowest sensor"
    return ["", "estimator:", *(f"  {key}: {value}" for key, value in found.items())] * bool(found)
