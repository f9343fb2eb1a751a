"""`fsw init URDF`: write a commented configuration of a robot, from flags or answers."""

import argparse
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from functools import lru_cache
from importlib.resources import files
from math import inf
from pathlib import Path
from typing import Any

import yaml

from fsw.checks.configuration import validate
from fsw.checks.robot import MOST_EFFORT_NM, MOST_SPEED_RAD_S, read_model
from fsw.checks.urdf import check_urdf
from fsw.commands.init_answers import Ask, angles, asker, mass_kg, one_of, three
from fsw.commands.out_argument import refuse_existing
from fsw.config import parse
from fsw.config.devices import linear
from fsw.estimators.model.inertia import PARAMETERS, from_parameters, is_consistent
from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray
from fsw.messages.errors import ConfigError

DENSITY_KG_M3 = 150.0  # typical of a satellite; gives a first guess of the target's size
UNKNOWN_EFFORT_NM, UNKNOWN_SPEED_RAD_S = 1e3, 10.0  # of a joint whose <limit> is a placeholder
LEAST_NOISE_NM = 3e-3  # rounding of a torque in a TPDO1
HELD = ("free", "planar", "clamped")
HEAD = """\
# Written by fsw init from {urdf}. Every key: docs/configuration.md. Check it: fsw check {out}
# Look at every line with CHECK; a recording tells more: fsw check {out} RECORDING
"""


@lru_cache(maxsize=1)
def library() -> dict[str, dict[str, dict[str, Any]]]:
    """Return the data of the devices in devices.yaml, by kind and name."""
    text = (files("fsw.commands") / "devices.yaml").read_text(encoding="utf-8")
    found: dict[str, dict[str, dict[str, Any]]] = yaml.safe_load(text)
    return found


def listing() -> str:
    """Return one line for each device of the library, with the source of its data."""
    return "\n".join(
        f"{kind} {name}: {device['title']}; {_trust(device)}"
        for kind, devices in library().items()
        for name, device in devices.items()
    )


def _trust(device: Mapping[str, Any]) -> str:
    return f"{'' if device['verified'] else 'NOT VERIFIED: '}{device['source']}"


def init(arguments: argparse.Namespace) -> str:
    """Write the configuration; return warnings on inertias and a line on what to check.

    Raises
    ------
    ConfigError when the robot cannot be used, a flag is missing or the file exists already.
    """
    out: Path = arguments.out
    refuse_existing(arguments)
    try:
        content = arguments.urdf.read_bytes()
        check_urdf(content)
    except OSError as error:
        raise ConfigError(f"{arguments.urdf}: cannot be read: {error.strerror}") from error
    except ConfigError as error:
        raise ConfigError(f"{arguments.urdf} {error}") from error
    ask = asker(arguments)
    root = ET.fromstring(content)
    base = _base(ask, root, arguments.base)
    leaves = _leaves(root)
    links = [link.get("name", "") for link in root.findall("link")]
    if not leaves:
        raise ConfigError(f"{arguments.urdf} has no link at the end of a chain: no tree of links")
    words = f"tool frame, one of {', '.join(leaves)}"
    tool = ask("tool", words, one_of(links), leaves[0] if leaves else "")
    model = read_model(arguments.urdf, tool)
    if model.n == 0:
        raise ConfigError(f"{arguments.urdf} has no joint that moves; at least 1 is needed")
    text = _text(arguments, ask, tool, root, model) + base
    config = parse(text.encode(), out.parent.absolute(), str(out))  # checks the text
    _, doubts = validate(config)
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"--out: {out} cannot be written: {error.strerror}") from error
    marked = f"{out}: {len(config.joints)} joints; {text.count('# CHECK')} lines marked CHECK"
    return "\n".join([*(f"warning: {doubt}" for doubt in doubts), marked])


def _base(ask: Ask, root: ET.Element, given: str | None) -> str:
    """Return the YAML section `base`, empty if free; ask if a massless root has a fixed joint."""
    held = given or "free"
    children = {child.get("link") for _, child in _ends(root, "child")}
    for joint, parent in _ends(root, "parent"):
        link = root.find(f"link[@name='{parent.get('link')}']")
        top = parent.get("link") not in children and joint.get("type") == "fixed"
        if given is None and top and link is not None and link.find("inertial") is None:
            words = f"the root link {link.get('name')!r} has no mass and a fixed joint"
            words += f"; what holds the base ({', '.join(HELD)})"
            held = ask("base", words, one_of(HELD))
            break
    if held == "free":
        return ""
    return f"""
base:
  motion: {held}
  gravity_B_m_s2: [0.0, 0.0, -9.80665]  # CHECK down is -z of the root link
"""


def _ends(root: ET.Element, kind: str) -> Iterable[tuple[ET.Element, ET.Element]]:
    """Yield every joint with its element `kind`: parent or child."""
    ends = ((joint, joint.find(kind)) for joint in root.findall("joint"))
    return ((joint, end) for joint, end in ends if end is not None)


def _device(kind: str, name: str) -> dict[str, Any]:
    devices = library()[kind]
    if name not in devices:
        close = get_close_matches(name, devices, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise ConfigError(f"{kind} {name!r}: {hint}known are {', '.join(devices)}")
    return devices[name]


def _leaves(root: ET.Element) -> list[str]:
    parents = {end.get("link") for _, end in _ends(root, "parent")}
    return [
        link.get("name", "") for link in root.findall("link") if link.get("name") not in parents
    ]


def _text(
    arguments: argparse.Namespace,
    ask: Ask,
    tool: str,
    root: ET.Element,
    model: RobotModel,
) -> str:
    which = one_of(("base", "target", "both"))
    unknown = ask("unknown", "unknown body (base, target or both)", which, "target")
    bodies = ["base", "target"] if unknown == "both" else [unknown]
    out, urdf = arguments.out, arguments.urdf.absolute()
    near = urdf.parent == out.parent.absolute()
    lines = [HEAD.format(urdf=urdf.name, out=out.name)]
    lines += [
        "robot:",
        f"  urdf: {_word(urdf.name if near else str(urdf))}",
        f"  tool_frame: {_word(tool)}",
        "",
    ]
    lines += [f"unknown: [{', '.join(bodies)}]", "bodies:"]
    if "base" in bodies:
        lines += _body("base", *from_parameters(_of_root(root, model)), 0.5)
    if "target" in bodies:
        mass = ask("target_mass_kg", "guess of the target's mass [kg]", mass_kg)
        side = (mass / DENSITY_KG_M3) ** (1 / 3)
        moment = mass * side**2 / 6
        inertia = [moment, 0.0, 0.0, moment, 0.0, moment]
        lines += _body("target", mass, [0.0, 0.0, side / 2], inertia, side)
    lines += _joints(arguments, model)
    lines += _imu(ask) + _tracker(ask)
    lines += ["", "scheduler:", f"  tick_rate_hz: {arguments.rate_hz}", ""]
    lines += [
        "recorder:",
        "  directory: recordings",
        "",
        "service:",
        "  state_directory: state",
        "",
    ]
    return "\n".join(lines)


def _of_root(root: ET.Element, model: RobotModel) -> FloatArray:
    """Return the parameters (10,) of the root link, the prior of an unknown base.

    Raises
    ------
    ConfigError if no body has them.
    """
    pi: FloatArray = model.pi_links[:PARAMETERS]
    if is_consistent(pi):
        return pi
    name, fault = _root_link(root), "an inertia that no body can have" if pi[0] else "no mass"
    raise ConfigError(
        f"--unknown: the root link {name!r} has {fault}, and the prior of the base comes from its "
        "<inertial>; correct it there, or choose --unknown target"
    )


def _root_link(root: ET.Element) -> str:
    """Return the name of the link that is no joint's child."""
    children = {end.get("link") for _, end in _ends(root, "child")}
    names = [link.get("name", "") for link in root.findall("link")]
    return next((name for name in names if name not in children), "")


def _word(text: str) -> str:
    """Return a name as a YAML scalar, quoted where YAML would read it as another type."""
    return yaml.safe_dump(text, width=inf, allow_unicode=True).removesuffix("\n...\n").strip()


def _numbers(values: Iterable[float]) -> str:
    return "[" + ", ".join(f"{float(value):.6g}" for value in values) + "]"


def _body(
    name: str, mass: float, com: Iterable[float], inertia: Iterable[float], reach: float
) -> list[str]:
    own = [float(value) for value in inertia]
    largest = max(own[0], own[3], own[5])
    spread = [0.5 * own[k] if k in (0, 3, 5) else 0.25 * largest for k in range(6)]
    return [
        f"  {name}:  # CHECK the prior: about right; half of it may be wrong, as sigma says",
        f"    mass_kg: {mass:.6g}",
        f"    com_m: {_numbers(com)}  # in the frame of the body",
        f"    inertia_kg_m2: {_numbers(own)}  # xx xy xz yy yz zz",
        "    sigma:",
        f"      mass_kg: {0.5 * mass:.6g}",
        f"      com_m: {_numbers([0.5 * reach] * 3)}",
        f"      inertia_kg_m2: {_numbers(spread)}",
    ]


def _joints(arguments: argparse.Namespace, model: RobotModel) -> list[str]:
    encoder, torque = _device("encoder", arguments.encoder), _device("torque", arguments.torque)
    lines = [
        "",
        "buses:",
        "  - name: arm  # recordings: /can/arm",
        "    interface: socketcan  # CHECK any of python-can's",
        "    channel: can0  # CHECK",
        "    bitrate: 1000000  # CHECK",
        f"    rate_hz: {arguments.rate_hz}",
        "",
        f"# encoder: {encoder['title']}; {_trust(encoder)}",
        f"# torque: {torque['title']}; {_trust(torque)}",
        "joints:",
    ]
    for k, (name, kind) in enumerate(zip(model.joint_names, model.kinds(), strict=True)):
        effort, in_effort = _limit(
            model.model.effortLimit[6 + k], MOST_EFFORT_NM, UNKNOWN_EFFORT_NM
        )
        speed, in_speed = _limit(
            model.model.velocityLimit[6 + k], MOST_SPEED_RAD_S, UNKNOWN_SPEED_RAD_S
        )
        noise = max(torque["noise_ratio"] * effort, LEAST_NOISE_NM)
        own = {
            "sign": "1  # CHECK -1: the node counts against the URDF's axis",
            "zero_offset_rad": "0.0",
            "torque_limit_nm": f"{effort:g}  # {in_effort}",
            "speed_limit_rad_s": f"{speed:g}  # {in_speed}",
            "torque_noise_nm": f"{noise:.3g}",
            "torque_offset_sigma_nm": f"{torque['offset_ratio'] * effort:.3g}",
            "torque_scale_sigma_ratio": f"{torque['torque_scale_sigma_ratio']:g}",
            "position_noise_rad": f"{encoder['position_noise_rad']:g}",
        }
        if kind == "prismatic":  # the encoder's numbers count in m, not rad
            own = {"kind": kind} | {linear(key): value for key, value in own.items()}
            own["position_noise_m"] += "  # CHECK"
        lines += [
            f"  - name: {_word(name)}",
            "    bus: arm",
            f"    node_id: 0x{arguments.first_node + k:02x}  # CHECK",
            *(f"    {key}: {value}" for key, value in own.items()),
        ]
    return lines


def _limit(given: float, most: float, otherwise: float) -> tuple[float, str]:
    """Return a limit of the URDF and a comment; a placeholder is replaced by `otherwise`."""
    if 0.0 < given <= most:
        return given, "of the URDF"
    return otherwise, f"CHECK the URDF has {given:g}, no limit of a joint"


def _imu(ask: Ask) -> list[str]:
    units = library()["imu"]
    words = f"inertial unit ({', '.join(units)}; none on a clamped base)"
    name = ask("imu", words, one_of((*units, "none")))
    if name == "none":
        return []
    device = _device("imu", name)
    place = ask("imu_xyz", "place of the inertial unit in the root link, x y z [m]", three)
    turn = ask("imu_rpy", "roll, pitch, yaw that take its axes to the root link's [rad]", angles)
    return [
        "",
        f"# {device['title']}; {_trust(device)}",
        "imu:",
        f"  driver: {device['driver']}",
        "  port: /dev/ttyUSB0  # CHECK",
        "  mounting:",
        f"    p_BS_m: {_numbers(place)}",
        f"    rpy_BS_rad: {_numbers(turn)}",
        *_figures(device),
    ]


def _tracker(ask: Ask) -> list[str]:
    name = ask(
        "tracker",
        f"star tracker ({', '.join(library()['star_tracker'])} or none)",
        one_of((*library()["star_tracker"], "none")),
        "none",
    )
    if name == "none":
        return []
    device = _device("star_tracker", name)
    turn = ask("tracker_rpy", "roll, pitch, yaw of the star tracker (boresight z) [rad]", angles)
    return [
        "",
        f"# {device['title']}; {_trust(device)}",
        "star_tracker:",
        f"  driver: {device['driver']}",
        "  port: /dev/ttyUSB1  # CHECK",
        "  mounting:",
        "    p_BS_m: [0.0, 0.0, 0.0]  # attitude does not depend on it",
        f"    rpy_BS_rad: {_numbers(turn)}",
        *_figures(device),
    ]


def _figures(device: Mapping[str, Any]) -> list[str]:
    words = ("title", "source", "verified", "driver")
    return [f"  {key}: {value}" for key, value in device.items() if key not in words]
