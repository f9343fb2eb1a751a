"""Text that describes a configuration, printed by `fsw check`."""

from collections.abc import Sequence

import numpy as np

from fsw.checks import budget
from fsw.config import BaseConfig, BodyConfig, BusConfig, Config
from fsw.config.feed import SAMPLES
from fsw.config.joints import minute_walk
from fsw.drivers.layout.joints import all_layouts, in_words
from fsw.estimators.effects.registered import ON_BASE
from fsw.estimators.model.inertia import PARAMETERS
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.state_groups import GROUPS


def describe(config: Config, problem: Problem, costs: Sequence[str] = ()) -> str:
    """Return a page of text with titled sections; `costs`: lines on the effects left out."""
    sections = (
        ("robot", _robot(config, problem)),
        ("bodies", _bodies(config, problem)),
        *((kind.section, kind.words(config)) for kind in ON_BASE if getattr(config, kind.section)),
        ("buses", _buses(config)),
        ("serial", _serial(config)),
        ("loop", _loop(config)),
        ("estimate", _estimate(config, problem)),
        *([("left out", costs)] if costs else []),
        ("telemetry", _telemetry(config)),
        ("files", _files(config)),
    )
    width = max(len(title) for title, _ in sections)
    return "\n".join(
        f"{title if row == 0 else '':<{width}}  {line}"
        for title, lines in sections
        for row, line in enumerate(lines)
    )


def _robot(config: Config, problem: Problem) -> list[str]:
    model = problem.model.plain
    masses = model.pi_links[::PARAMETERS]
    joints = [
        f"{name} {mass:.4g}" for name, mass in zip(model.joint_names, masses[1:], strict=True)
    ]
    blind = [joint.name for joint in config.joints if joint.torque == "none"]
    return [
        f"{config.resolve(config.robot.urdf)}, tool frame {config.robot.tool_frame}",
        f"{model.n} joints; mass moved by each [kg]: {', '.join(joints)}",
        f"root link {masses[0]:.6g} kg, all links {masses.sum():.6g} kg",
        *_held(config.base),
        *([f"without torque sensor: {', '.join(blind)}"] if blind else []),
        *(
            f"wrench sensor {own.name}: carries {own.frame!r} and all beyond, {own.rate_hz:g} Hz"
            for own in config.wrench_sensors
        ),
        *_by_speed(config),
    ]


def _by_speed(config: Config) -> list[str]:
    """Return a line for each joint that measures speed only, with the drift of its angle [rad]."""
    rates_hz = {bus.name: bus.rate_hz for bus in config.buses}
    return [
        f"{joint.name}: speed only; its angle is integrated from {joint.start_rad:.4g} +- "
        f"{joint.zero_sigma_rad:.2g} and walks {minute_walk(joint, rates_hz[joint.bus]):.2g} in a "
        "minute"
        for joint in config.joints
        if joint.speed_only
    ]


def _held(base: BaseConfig) -> list[str]:
    """Return a line on how the base is held and on gravity; no line for a free base."""
    if base.motion == "free":
        return []
    gravity = " ".join(f"{x:.6g}" for x in base.gravity_B_m_s2)
    return [f"base {base.motion}, gravity [{gravity}] m/s^2 in its axes"]


def _bodies(config: Config, problem: Problem) -> list[str]:
    lines = []
    for name in dict.fromkeys(("base", "target", *config.bodies)):
        body = config.bodies.get(name)
        if name in problem.unknown and body is not None:
            lines.append(f"{name}: unknown; prior {_body(body)}")
        elif body is not None:
            lines.append(f"{name}: known; {_body(body)}")
        else:
            known = "known; as the URDF's root link" if name == "base" else "none grasped"
            lines.append(f"{name}: {known}")
    return lines


def _body(body: BodyConfig) -> str:
    com = " ".join(f"{x:.4g}" for x in body.com_m)
    inertia = " ".join(f"{x:.4g}" for x in body.inertia_kg_m2)
    text = f"mass {body.mass_kg:.6g}"
    if body.sigma is not None:
        text += f" +- {body.sigma.mass_kg:.4g}"
    return f"{text} kg, centre of mass [{com}] m, inertia [{inertia}] kg m^2"


def _buses(config: Config) -> list[str]:
    lines = []
    for bus in config.buses:
        if bus.feed is not None:
            lines += _feed(config, bus)
            continue
        if bus.interface == SAMPLES:
            names = ", ".join(joint.name for joint in config.joints if joint.bus == bus.name)
            lines.append(f"{bus.name}: samples of a recording, {bus.rate_hz:g} Hz; joints {names}")
            continue
        nodes = [
            f"0x{own.node_id:02x} {own.name}"
            for own in config.can_nodes
            if own.bus == bus.name and own.driver == "canopen"
        ]
        load = budget.bus_load(config, bus)
        assumed = "" if bus.bitrate else f" at an assumed {budget.ASSUMED_BITRATE} bit/s"
        layouts = all_layouts(config, bus)
        share = "not predicted" if layouts else f"{load:.0%}{assumed}"
        counter = f", counter 1..{bus.sync_counter_max}" * (bus.sync != "none")
        lines.append(
            f"{bus.name}: {bus.interface} {bus.channel}{', CAN FD' if bus.fd else ''}; SYNC "
            f"{bus.sync}, {bus.rate_hz:g} Hz{counter}; worst-case load {share}; topic "
            f"/can/{bus.name}"
        )
        described = [f"  {in_words(config.bus_devices[at], own)}" for at, own in layouts.items()]
        lines += described
        if nodes or not described:
            lines.append(f"  nodes {', '.join(nodes) or 'none'}")
    return lines


def _feed(config: Config, bus: BusConfig) -> list[str]:
    """Return lines on a live feed: where from, whose clock, whether with a key, and the order."""
    feed = bus.feed
    if feed is None:
        return []
    place = bus.channel if bus.port is None else f"UDP {bus.channel}:{bus.port}"
    key = "with a key" if feed.key_file else "without a key"
    names = [joint.name for joint in config.joints if joint.bus == bus.name]
    return [
        f"{bus.name}: feed of source {feed.source} at {place}, {bus.rate_hz:g} Hz, clock "
        f"{feed.clock}, {key}; topic /serial/{bus.name}",
        f"  joints in order {', '.join(names) or 'none'}",
    ]


def _serial(config: Config) -> list[str]:
    imu, tracker = config.imu, config.star_tracker
    shortest, longest = budget.imu_load(imu)
    lines = ["no inertial unit"]
    if imu.present and imu.bus is not None:
        lines = [f"imu: {imu.driver} on {imu.bus}, {imu.rate_hz:g} Hz"]
    elif imu.present:
        delays = f"gyro {imu.gyro_group_delay_s * 1e3:g} ms, accelerometer "
        lines = [
            f"imu: {imu.driver} on {imu.port}, {imu.baud_rate} bit/s, {imu.rate_hz:g} Hz; line "
            f"load {shortest:.0%} to {longest:.0%} by datagram; group delay {delays}"
            f"{imu.acc_group_delay_s * 1e3:g} ms; topic /serial/imu"
        ]
    if tracker is None:
        lines.append("star_tracker: none")
    elif tracker.bus is not None:
        lines.append(f"star_tracker: {tracker.driver} on {tracker.bus}, {tracker.rate_hz:g} Hz")
    else:
        lines.append(
            f"star_tracker: {tracker.driver} on {tracker.port}, {tracker.baud_rate} bit/s, "
            f"{tracker.rate_hz:g} Hz; time by {tracker.time}, latency {tracker.latency_s * 1e3:g} "
            "ms; topic /serial/star_tracker"
        )
    return lines


def _loop(config: Config) -> list[str]:
    scheduler = config.scheduler
    priority = scheduler.realtime_priority
    real_time = f"SCHED_FIFO {priority}" if priority else "no real time"
    cpu = "any processor" if scheduler.cpu is None else f"processor {scheduler.cpu}"
    return [
        f"{scheduler.tick_rate_hz:g} Hz, {real_time}, "
        f"{cpu}; status {config.service.status_rate_hz:g} Hz"
    ]


def _estimate(config: Config, problem: Problem) -> list[str]:
    estimator = config.estimator
    lags = {f"bus {bus.name}": budget.joint_delay_s(bus, config.scheduler) for bus in config.buses}
    lags["imu"] = budget.imu_delay_s(config.imu, config.scheduler)
    if config.star_tracker is not None:
        lags["star_tracker"] = budget.star_tracker_delay_s(config.star_tracker, config.scheduler)
    lags |= {
        own.name: budget.actuator_delay_s(own, config)
        for actuators in config.actuators.values()
        for own in actuators
        if own.late_s
    }
    slowest = max(lags, key=lambda name: lags[name])
    sigmas = problem.prior_covariance.diagonal() ** 0.5
    shown = [k for k in problem.published if k >= problem.bodies.stop]
    nuisances = [f"{problem.names[k]} 0 +- {sigmas[k]:.3g}" for k in shown]
    return [
        f"{estimator.method}, weighting {estimator.weighting}; windows of {estimator.window_s:g} s "
        f"read at {estimator.nodes} instants, closed {estimator.lag_s * 1e3:g} ms after their end "
        f"(slowest: {slowest}, {lags[slowest] * 1e3:.1f} ms)",
        f"{len(problem.names)} states: {PARAMETERS} of each unknown body"
        f"{', ' + ', '.join(nuisances) if nuisances else ''}",
        f"in doubt, estimated along: {', '.join(_doubts(config, problem)) or 'nothing'}",
        f"taken as exact: {', '.join(_certain(config, problem)) or 'nothing'}",
        "  an error in it, or a slow change, moves the bodies and no sigma says so until residuals "
        "show it; with a RECORDING, check says by how much",
        f"effects that are off: {', '.join(_off(config, problem)) or 'none'}",
        f"valid after {estimator.settle_blocks} windows "
        f"({estimator.settle_blocks * estimator.window_s:g} s) at the earliest",
    ]


def _doubts(config: Config, problem: Problem) -> list[str]:
    """Return the data of arm and sensors that are estimated too, with the largest prior sigma."""
    rates_hz = {bus.name: bus.rate_hz for bus in config.buses}
    known = {name.rpartition(".")[0] for name in problem.names if name.startswith("known.")}
    found = [f"{len(known)} known bodies"] if known else []
    sigmas = np.sqrt(np.diag(problem.prior_covariance))
    for group in GROUPS:
        states = problem.at(group.name)
        if group.name == "joint_walk" and states.stop:
            own = [minute_walk(j, rates_hz[j.bus]) for j in config.joints if j.speed_only]
            found.append(f"{group.effect} in a minute [{group.unit}] {max(own):.3g}")
        elif group.is_exact_if_absent and states.stop:
            found.append(f"{group.title} {sigmas[states].max():.3g}")
    return found


def _states(problem: Problem) -> set[str]:
    """Return the kinds of the problem's states, such as `gyro_bias`."""
    return {name.partition(".")[0] for name in problem.names}


def _certain(config: Config, problem: Problem) -> list[str]:
    """Return the data of arm, base and sensors that the estimator assumes to be exact."""
    joints, states = config.joints, _states(problem)
    bodies = {name.split(".")[1] for name in problem.names if name.startswith("known.")}
    linkless = {name.split(".")[2] for name in problem.names if name.startswith("known.link.")}
    links = [joint.name for joint in joints if joint.name not in linkless]
    exact = {
        "geometry of the arm": True,
        "links": len(links) == len(joints),
        f"links of {', '.join(links)}": 0 < len(links) < len(joints),
        "base": not {"base"} & {*problem.unknown, *bodies} and config.base.motion != "clamped",
        **{
            group.effect: group.name not in states and group.applies_to(config)
            for group in GROUPS
            if group.is_exact_if_absent and group.name != "known"
        },
    }
    return [name for name, is_exact in exact.items() if is_exact]


def _off(config: Config, problem: Problem) -> list[str]:
    """Return the effects that the model leaves out, each with the key that would add it.

    If an effect is configured for some joints only, the other joints are named. Effects that cannot
    occur, such as the momentum of a clamped base, are not listed.
    """
    groups = [g for g in GROUPS if g.applies_to(config) and not g.is_exact_if_absent]
    groups.sort(key=lambda group: not group.joint_key)  # joints first
    off = [
        f"{group.effect}{_where(config, group.joint_key)} ({group.key})"
        for group in groups
        if not problem.at(group.name).stop or _where(config, group.joint_key)
    ]
    if not all(joint.torque_model_sigma_nm for joint in config.joints):
        where = _where(config, "torque_model_sigma_nm")
        off.append(f"torque that no model has{where} (joints[].torque_model_sigma_nm)")
    off += [
        f"{kind.absent} ({kind.section})"
        for kind in ON_BASE
        if kind.is_possible(config) and not getattr(config, kind.section)
    ]
    if config.base.motion == "free":
        if config.estimator.outside_wrench == "ignore":
            off.append("unknown firings, contact of the target (estimator.outside_wrench)")
        if config.orbit is None:
            off.append("gravity gradient (orbit)")
    for name, body in config.bodies.items():
        moving_kg = sum(part.mass_kg for part in body.liquid)
        if moving_kg:
            off.append(
                f"motion of {moving_kg:.4g} kg of liquid in {name}, which may cost as much of its "
                "mass and is in its sigma (modes)"
            )
    return off


def _where(config: Config, key: str) -> str:
    """Return the joints without a key, in words; empty if it is no joint's, or no joint has it."""
    without = [joint.name for joint in config.joints if key and not getattr(joint, key)]
    return f" at {', '.join(without)}" if 0 < len(without) < len(config.joints) else ""


def _telemetry(config: Config) -> list[str]:
    telemetry = config.telemetry
    if telemetry is None:
        return ["none, and no telecommands"]
    commands = "telecommands in clear"
    if telemetry.sdls is not None:
        keys = ", ".join(f"SPI {key.spi} {key.role}" for key in telemetry.sdls.keys)
        commands = f"telecommands authenticated, {keys}"
    push = "" if telemetry.udp is None else f", UDP to {telemetry.udp.host}:{telemetry.udp.port}"
    return [
        f"TCP {telemetry.host}:{telemetry.port}{push}; {commands}; starts in "
        f"{telemetry.start_mode}; science at most {telemetry.science_rate_hz:g} Hz"
    ]


def _files(config: Config) -> list[str]:
    recorder = config.recorder
    recordings = "none"
    if recorder.directory is not None:
        recordings = f"{config.resolve(recorder.directory)} (MCAP, {recorder.compression})"
    return [
        f"recordings: {recordings}",
        f"state: {config.resolve(config.service.state_directory)}",
        f"configuration CRC-32: {config.crc32:08x}",
    ]
