"""`fsw init URDF`: write a commented configuration of a robot, from flags or answers."""

import argparse
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from pathlib import Path

from fsw.checks.configuration import validate
from fsw.checks.robot import read_model
from fsw.checks.urdf import check_urdf
from fsw.config import parse
from fsw.config.feed import SAMPLES
from fsw.errors import ConfigError
from fsw.estimators.model.inertia import PARAMETERS, from_parameters, is_consistent
from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray
from offline.check_log import frame_findings
from offline.checks.comparison import WRONG
from offline.init.answers import Ask, mass_kg, one_of
from offline.init.devices import device, library, listing
from offline.init.recording import RATE_HZ, Recorded, recorded
from offline.init.text import (
    body_lines,
    bus_lines,
    estimator_lines,
    imu_lines,
    joint_lines,
    links_lines,
    tracker_lines,
    word,
)
from offline.init.wires import wired
from offline.out_argument import refuse_existing

DENSITY_KG_M3 = 150.0  # typical of a satellite; gives a first guess of the target's size
HELD = ("free", "planar", "clamped")
HEAD = """\
# Written by fsw init from {urdf}. Every key: docs/configuration.md. Check it: fsw check {out}
# Look at every line with CHECK; a recording tells more: fsw check {out} RECORDING
"""


def init(arguments: argparse.Namespace) -> str:
    """Write the configuration; return warnings on inertias and a line on what to check.

    Raises
    ------
    ConfigError when the robot cannot be used, a flag is missing or the file exists already.
    """
    out: Path = arguments.out
    refuse_existing(arguments)

    def found_in(model: RobotModel) -> Recorded | None:
        if arguments.bus or arguments.eds or arguments.feed:
            return wired(arguments, model)
        found = None if arguments.recording is None else recorded(arguments.recording, model)
        if found is not None and found.is_table:
            _name_sensors(arguments, found, moves=arguments.base != "clamped")
        return found

    text, found = described(arguments, found_in)
    files = {out: text}
    config = parse(text.encode(), out.parent.absolute(), str(out))  # checks the text
    _, doubts = validate(config)
    mapping = out.parent / f"{out.stem}.map.yaml"
    if found is not None and found.mapping:
        files[mapping] = "\n".join([*found.mapping, ""])
        refuse_existing(argparse.Namespace(mapping=mapping, force=arguments.force), "mapping")
    for path, text in files.items():
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"--out: {path} cannot be written: {error.strerror}") from error
    many = sum(text.count("# CHECK") for text in files.values())
    log = arguments.recording if found is not None and found.wires and not arguments.feed else None
    if log is not None:
        doubts += [line for line in frame_findings(log, config)[0] if line.startswith(WRONG)]
    lines = [*(f"warning: {doubt}" for doubt in doubts)]
    lines.append(f"{out}: {len(config.joints)} joints; {many} lines marked CHECK")
    if found is not None and found.wires is not None:
        lines += [f"then: fsw check {out} {'' if log is None else log}".rstrip()]
    elif found is not None:
        source = f"{arguments.recording} --map {mapping}"
        source = source if found.mapping else f"--can arm={arguments.recording}"
        lines.append(f"then: fsw import {source} --config {out} --out recording.mcap")
    return "\n".join(lines)


def described(
    arguments: argparse.Namespace, found_in: Callable[[RobotModel], Recorded | None]
) -> tuple[str, Recorded | None]:
    """Return the text of the configuration, and what `found_in` found in a recording of the robot.

    Answers that are found or have a default are stored in `arguments`.

    Raises
    ------
    ConfigError when the robot cannot be used or a flag is missing.
    """
    try:
        content = arguments.urdf.read_bytes()
        check_urdf(content)
    except OSError as error:
        raise ConfigError(f"{arguments.urdf}: cannot be read: {error.strerror}") from error
    except ConfigError as error:
        raise ConfigError(f"{arguments.urdf} {error}") from error
    ask = Ask(arguments)
    root = ET.fromstring(content)
    base = _base(ask, root, arguments)
    leaves = _leaves(root)
    links = [link.get("name", "") for link in root.findall("link")]
    if not leaves:
        raise ConfigError(f"{arguments.urdf} has no link at the end of a chain: no tree of links")
    words = f"tool frame, one of {', '.join(leaves)}"
    tool = ask("tool", words, one_of(links), leaves[0] if leaves else "")
    model = read_model(arguments.urdf, tool)
    if model.n == 0:
        raise ConfigError(f"{arguments.urdf} has no joint that moves; at least 1 is needed")
    is_held = arguments.base == "clamped"
    found = found_in(model)
    is_current = found is not None and found.is_current
    usual = "motor_current" if is_current else "arm_sensor" if is_held else "generic"
    arguments.torque = arguments.torque or usual
    text = _text(arguments, ask, tool, root, model, found)
    if is_held and arguments.unknown in ("base", "both"):
        raise ConfigError(f"--unknown: {arguments.unknown!r}; a clamped base cannot be found")
    ask.require_all()
    return text + base, found


def _name_sensors(arguments: argparse.Namespace, found: Recorded, *, moves: bool) -> None:
    """Name the sensors of a table; raise ConfigError for one that is needed and has no columns."""
    if moves and not found.imu_rate_hz:
        raise ConfigError(
            f"--recording {arguments.recording}: no columns of an inertial unit, and a base that "
            "moves needs one; is it --base clamped?"
        )
    for name, rate_hz in (("imu", found.imu_rate_hz), ("tracker", found.tracker_rate_hz)):
        if getattr(arguments, name) is None:
            setattr(arguments, name, SAMPLES if rate_hz else "none")
        given = getattr(arguments, name)
        if given != "none" and not rate_hz:
            raise ConfigError(
                f"--{name}: {given}, and {arguments.recording} has no columns of it; must be none"
            )


def _base(ask: Ask, root: ET.Element, arguments: argparse.Namespace) -> str:
    """Return the YAML section `base`, empty if free; ask if a massless root has a fixed joint."""
    given = arguments.base
    held = given or "free"
    children = {child.get("link") for _, child in _ends(root, "child")}
    for joint, parent in _ends(root, "parent"):
        link = root.find(f"link[@name='{parent.get('link')}']")
        top = parent.get("link") not in children and joint.get("type") == "fixed"
        if given is None and top and link is not None and link.find("inertial") is None:
            words = f"the root link {link.get('name')!r} has no mass and a fixed joint"
            words += f"; what holds the base ({', '.join(HELD)})"
            held = ask("base", words, one_of(HELD), stand_in=HELD[0])
            ask.require_all()  # it decides what else is needed
            break
    arguments.base = held
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
    found: Recorded | None,
) -> str:
    which = one_of(("base", "target", "both"))
    unknown = ask("unknown", "unknown body (base, target or both)", which, "target")
    bodies = ["base", "target"] if unknown == "both" else [unknown]
    out, urdf = arguments.out, arguments.urdf.absolute()
    near = urdf.parent == out.parent.absolute()
    lines = [HEAD.format(urdf=urdf.name, out=out.name)]
    lines += [
        "robot:",
        f"  urdf: {word(urdf.name if near else str(urdf))}",
        f"  tool_frame: {word(tool)}",
        *links_lines(device("torque", arguments.torque)),
        "",
    ]
    lines += [f"unknown: [{', '.join(bodies)}]", "bodies:"]
    if "base" in bodies:
        lines += body_lines("base", *from_parameters(_of_root(root, model)), 0.5)
    if "target" in bodies:
        mass = ask("target_mass_kg", "guess of the target's mass [kg]", mass_kg, stand_in="1")
        side = (mass / DENSITY_KG_M3) ** (1 / 3)
        moment = mass * side**2 / 6
        inertia = [moment, 0.0, 0.0, moment, 0.0, moment]
        lines += body_lines("target", mass, [0.0, 0.0, side / 2], inertia, side)
    rate_hz = arguments.rate_hz or (RATE_HZ if found is None else found.rate_hz)
    buses, each = bus_lines(rate_hz, model.n, found)
    imu, unit = imu_lines(ask, found)
    tracker, its_unit = tracker_lines(ask, found)
    lines += [*buses, *joint_lines(arguments, model, each, found), *imu, *tracker]
    lines += ["", "scheduler:", f"  tick_rate_hz: {rate_hz!r}"]
    lines += estimator_lines(rate_hz, unit, its_unit)
    lines += [
        "",
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
    """Return the name of the link that is not the child of a joint."""
    children = {end.get("link") for _, end in _ends(root, "child")}
    names = [link.get("name", "") for link in root.findall("link")]
    return next((name for name in names if name not in children), "")


__all__ = ["RATE_HZ", "init", "library", "listing"]
