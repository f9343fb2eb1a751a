"""Find faults of a configuration before any device is opened.

`fsw run`, `fsw replay` and `fsw check` all call `validate`. Each fault is one line with key, value
and bound.
"""

import os
from collections.abc import Iterator
from math import hypot, sqrt, tau
from pathlib import Path

from fsw.checks import budget
from fsw.checks.interfaces import SIMULATED, interface_fault
from fsw.checks.rehearsal import rehearse
from fsw.checks.robot import inertia_warnings, load_problem
from fsw.checks.windows import lag_faults, window_faults
from fsw.config import BusConfig, Config
from fsw.config.feed import SAMPLES
from fsw.config.joints import minute_walk
from fsw.config.keys import read_key
from fsw.config.telemetry import BUS_SLOTS, JOINT_SLOTS
from fsw.drivers.codecs.entries import imu_codec
from fsw.drivers.layout.joints import all_layouts, torque_steps_nm
from fsw.errors import ConfigError
from fsw.estimators.effects.registered import ON_BASE
from fsw.estimators.model.problem import Problem

LONG_LEVER_M = 10.0  # a longer lever arm of the inertial unit is probably in millimetres
FAST_RAD_S = 2.0 * tau  # a faster speed limit of a joint is probably in degrees
LARGE_WALK_RAD = 5e-3  # drift of an integrated angle in a minute above which sigmas are too small
FULL_LOAD = 1.0
HIGH_LOAD = 0.7
IN_KBIT_LOAD = 50.0  # a load above this is probably of a bit rate in kbit/s
MAX_GROUP_DELAY_S = 0.1  # a longer delay is probably in milliseconds
POSITION_STEP_RAD = tau * 2.0**-24
LINKS = Path("/sys/class/net")
IFF_UP = 1  # bit of an interface's flags: Linux include/uapi/linux/if.h


def validate(config: Config) -> tuple[Problem, list[str]]:
    """Check a configuration, including a dry update; open no device and write no file.

    Returns
    -------
    The estimation problem of the configuration, and a line for each warning.

    Raises
    ------
    ConfigError with one line per fault.
    """
    faults: list[str] = []
    problem: Problem | None = None
    try:
        faults += _device_faults(config)
        if not faults:  # a wrong rate or delay would be reported with its effects
            faults += [*window_faults(config), *lag_faults(config)]
        problem = load_problem(config)
        if not faults:
            rehearse(config, problem)
    except ConfigError as error:
        faults += str(error).splitlines()
    if faults or problem is None:
        raise ConfigError("\n".join(f"{config.name}: {fault}" for fault in faults))
    return problem, [*_warnings(config), *inertia_warnings(config, problem.model.plain)]


def _device_faults(config: Config) -> list[str]:
    return [
        *_bus_faults(config),
        *_description_faults(config),
        *_serial_faults(config),
        *_key_faults(config),
    ]


def _noise_warnings(config: Config) -> Iterator[str]:
    """Yield a line for each implausible noise of the joints' samples."""
    sampled = [bus.name for bus in config.buses if bus.interface == SAMPLES]
    rates_hz = {bus.name: bus.rate_hz for bus in config.buses}
    torque_steps = torque_steps_nm(config)
    for i, joint in enumerate(config.joints):
        walk = minute_walk(joint, rates_hz[joint.bus])
        if walk > LARGE_WALK_RAD:
            (key,) = joint.named({"speed_noise_rad_s": None})
            unit = "rad" if joint.kind == "revolute" else "m"
            yield (
                f"joints.{i}.{key} ({joint.name}): its position walks {walk:.2g} {unit} in a "
                f"minute; above {LARGE_WALK_RAD:g} sigmas come out too small"
            )
        if joint.bus in sampled:
            continue
        step = POSITION_STEP_RAD if joint.kind == "revolute" else POSITION_STEP_RAD / tau
        steps = {"torque_noise_nm": (joint.torque_noise_nm, torque_steps[i])}
        if joint.driver == "described":
            pass  # the step of its angle is the device's
        elif joint.speed_noise_rad_s is None:
            steps["position_noise_rad"] = (joint.position_noise_rad, step)
        else:
            steps["speed_noise_rad_s"] = (joint.speed_noise_rad_s, step)
        for key, (sigma, size) in joint.named(steps).items():
            if sigma < size / sqrt(12):
                rounding = f"{size / sqrt(12):.2g}"
                yield f"joints.{i}.{key}: {sigma:g} is below the rounding of the wire, {rounding}"


def _warnings(config: Config) -> list[str]:
    found = []
    for i, bus in enumerate(config.buses):
        load = budget.bus_load(config, bus)
        if load > HIGH_LOAD:
            found.append(
                f"buses.{i}.rate_hz: {bus.rate_hz:g} loads {bus.name!r} to {load:.0%} "
                f"{_bitrate_words(bus)}; above {HIGH_LOAD:.0%} late frames must be expected"
            )
        if bus.feed is None and all(own.bus != bus.name for own in config.bus_devices.values()):
            found.append(f"buses.{i}.name: no joint uses the bus {bus.name!r}")
    found += _noise_warnings(config)
    longest = budget.imu_load(config.imu)[1]
    if longest > FULL_LOAD:
        found.append(
            f"imu.baud_rate: {config.imu.baud_rate} does not carry the longest datagram at "
            f"{config.imu.rate_hz:g} Hz ({longest:.0%}); shorter ones fit"
        )
    found += [
        f"joints.{i}.speed_limit_rad_s ({joint.name}): {joint.speed_limit_rad_s:g} rad/s are "
        f"{joint.speed_limit_rad_s / tau:.2g} turns a second; are these degrees?"
        for i, joint in enumerate(config.joints)
        if joint.kind == "revolute" and joint.speed_limit_rad_s > FAST_RAD_S
    ]
    is_blind = all(joint.torque == "none" for joint in config.joints) and not config.wrench_sensors
    if config.base.motion == "clamped" and is_blind:
        found.append(
            "joints[].torque: all are none; on a clamped base only torques, or wrench_sensors, "
            "show a body"
        )
    found += _mounting_warnings(config)
    found += [line for kind in ON_BASE for line in kind.warnings(config)]
    estimator = config.estimator
    if estimator.method != "mrnea" and estimator.weighting != "eiv":
        found.append(
            f"estimator.weighting: {estimator.weighting!r} does nothing to estimator.method "
            f"{estimator.method!r}, only to a batch of mrnea; must be 'eiv' with this method"
        )
    others = list(config.actuators)
    rated = config.estimator.method != "mrnea"  # rows of mrnea need no momentum
    if others and rated and config.base.motion == "free" and not estimator.momentum_sigma_nms:
        found.append(
            f"estimator.momentum_sigma_nms: 0 with {' and '.join(others)}: their momentum and the "
            "base's must be zero together; must be what the spacecraft may hold"
        )
    if estimator.momentum_sigma_nms and config.star_tracker is None:
        found.append(
            f"estimator.momentum_sigma_nms: {estimator.momentum_sigma_nms:g} without star_tracker; "
            "the momentum needs the attitude, only the measured rate is used"
        )
    cpus = os.cpu_count() or 1
    for key in ("cpu", "estimation_cpu"):
        cpu = getattr(config.scheduler, key)
        if cpu is not None and cpu >= cpus:
            found.append(f"scheduler.{key}: {cpu} is not below this machine's {cpus}")
    return [*found, *_telemetry_warnings(config)]


def _telemetry_warnings(config: Config) -> list[str]:
    """Return a line for each part of the data, or rate, that telemetry cannot provide."""
    telemetry = config.telemetry
    if telemetry is None:
        return []
    rate_hz, tick_rate_hz = telemetry.science_rate_hz, config.scheduler.tick_rate_hz
    found = [
        f"{key}: {len(names)}, but telemetry has room for {slots}: no packet holds "
        f"{', '.join(map(repr, names[slots:]))}; the recording holds all"
        for key, names, slots in (
            ("joints", [joint.name for joint in config.joints], JOINT_SLOTS),
            ("buses", [bus.name for bus in config.buses], BUS_SLOTS),
        )
        if len(names) > slots
    ]
    others = [name for name in config.unknown if name not in ("base", "target")]
    if others:
        found.append(
            f"unknown: no telemetry packet holds {', '.join(map(repr, others))}; the recording does"
        )
    if rate_hz > tick_rate_hz:
        found.append(
            f"telemetry.science_rate_hz: {rate_hz:g} is above scheduler.tick_rate_hz "
            f"{tick_rate_hz:g}, which is the fastest it can be"
        )
    return found


def validate_ports(config: Config) -> None:
    """Check that every device has a port: a live run needs them, a replay does not.

    Raises
    ------
    ConfigError with one line per fault.
    """
    sampled = [
        f"buses.{i}.interface"
        for i, bus in enumerate(config.buses)
        if bus.interface == SAMPLES and bus.feed is None
    ]
    for section, actuators in config.actuators.items():
        sampled += [f"{section}.{i}.bus" for i, own in enumerate(actuators) if own.bus is None]
    sampled += [f"wrench_sensors.{i}" for i in range(len(config.wrench_sensors))]
    sampled += [
        f"{own.name}.driver" for own in config.sensors if own.driver == SAMPLES and own.bus is None
    ]
    if sampled:
        words = "samples is not a device without a feed; only recordings of fsw import have them"
        raise ConfigError("\n".join(f"{config.name}: {key}: {words}" for key in sampled))
    if faults := config.missing_ports():
        lines = [f"{config.name}: {key}: missing; only a replay works without" for key in faults]
        raise ConfigError("\n".join(lines))


def missing_devices(config: Config) -> list[str]:
    """Return a line for each port that is not configured, or cannot be used now; open none."""
    ports = config.line_ports
    absent = config.missing_ports()
    paths = {
        key: Path(config.device(port))
        for key, port in ports.items()
        if port is not None and "://" not in port
    }
    return [
        *(f"{key}: not given; a replay works without, fsw run does not" for key in absent),
        *(f"{key}: {path} does not exist now" for key, path in paths.items() if not path.exists()),
        *(
            f"{key}: {path} may not be read and written by this user; is it in its group?"
            for key, path in paths.items()
            if path.exists() and not os.access(path, os.R_OK | os.W_OK)
        ),
        *(
            f"buses.{i}.channel: {words}"
            for i, bus in enumerate(config.buses)
            if bus.interface == "socketcan" and (words := _link_fault(bus))
        ),
        *(
            f"buses.{i}.channel: {place.parent} does not exist now"
            for i, bus in enumerate(config.buses)
            if bus.feed is not None and bus.channel is not None
            if isinstance(place := config.feed_place(bus), Path) and not place.parent.is_dir()
        ),
    ]


def _link_fault(bus: BusConfig) -> str:
    """Return the reason why a CAN interface cannot be used now; empty: it can be used."""
    link = LINKS / (bus.channel or "")
    if not bus.channel or not link.exists():
        return f"no interface {bus.channel} on this machine now; see `ip link`"
    if int((link / "flags").read_text(), 16) & IFF_UP:
        return ""
    rate = f"type can bitrate {bus.bitrate}" if bus.bitrate else "with its bit rate"
    return f"{bus.channel} is down; ip link set {bus.channel} up {rate}"


def _bitrate_words(bus: BusConfig) -> str:
    if bus.bitrate is None:
        return f"at an assumed {budget.ASSUMED_BITRATE} bit/s"
    return f"at buses.bitrate {bus.bitrate}"


def _bus_faults(config: Config) -> list[str]:
    faults = []
    for i, bus in enumerate(config.buses):
        load = budget.bus_load(config, bus)
        simulated = bus.bitrate is None and bus.interface in SIMULATED
        if load > FULL_LOAD and not simulated:
            faults.append(
                f"buses.{i}.rate_hz: {bus.rate_hz:g} loads {bus.name!r} to {load:.0%} "
                f"{_bitrate_words(bus)}; must be at most {FULL_LOAD:.0%}, worst-case bit stuffing "
                f"included{'; is the bit rate in kbit/s?' * (load > IN_KBIT_LOAD)}"
            )
        if words := interface_fault(bus):
            faults.append(f"buses.{i}.interface: {words}")
        if bus.data_bitrate is not None and bus.data_bitrate < (bus.bitrate or 0):
            faults.append(
                f"buses.{i}.data_bitrate: {bus.data_bitrate} must be at least bitrate {bus.bitrate}"
            )
        if abs(bus.latch_offset_s) * bus.rate_hz >= 1.0:
            faults.append(
                f"buses.{i}.latch_offset_s: {bus.latch_offset_s:g} must be shorter than one SYNC "
                f"period, {1.0 / bus.rate_hz:g}"
            )
    return faults


def _description_faults(config: Config) -> list[str]:
    faults: list[str] = []
    for bus in config.buses:
        try:
            all_layouts(config, bus)
        except ConfigError as error:
            faults += str(error).splitlines()
    return faults


def _serial_faults(config: Config) -> list[str]:
    faults = []
    imu, tracker = config.imu, config.star_tracker
    if imu.is_serial:
        codec = imu_codec(imu)
        if codec.rates_hz and imu.rate_hz not in codec.rates_hz:
            rates = ", ".join(f"{rate:g}" for rate in codec.rates_hz)
            faults.append(f"imu.rate_hz: {imu.rate_hz:g} must be one of {rates}")
        if imu.max_rate_rad_s >= codec.max_rate_rad_s:
            faults.append(
                f"imu.max_rate_rad_s: {imu.max_rate_rad_s:g} must be below "
                f"{codec.max_rate_rad_s:.4g}, the most that the wire carries; a saturated reading "
                "would count as measured"
            )
    shortest = budget.imu_load(imu)[0]
    if shortest > FULL_LOAD:
        faults.append(
            f"imu.baud_rate: {imu.baud_rate} cannot carry {imu.rate_hz:g} datagrams a second; must "
            f"be at least {round(shortest * imu.baud_rate)}"
        )
    for key in ("gyro_group_delay_s", "acc_group_delay_s"):
        delay_s = getattr(imu, key)
        if delay_s > MAX_GROUP_DELAY_S:
            faults.append(f"imu.{key}: {delay_s:g} must be at most {MAX_GROUP_DELAY_S:g} (seconds)")
    if tracker is not None and tracker.is_serial:
        load = budget.star_tracker_load(tracker)
        if load > FULL_LOAD:
            faults.append(
                f"star_tracker.baud_rate: {tracker.baud_rate} cannot carry {tracker.rate_hz:g} "
                f"solutions a second; must be at least {round(load * tracker.baud_rate)}"
            )
        ports = [port for port in (tracker.port, imu.port) if port is not None]
        devices = {config.resolve(Path(port)).resolve() for port in ports}
        if len(devices) < len(ports):
            faults.append(
                f"star_tracker.port: {tracker.port} is the same device as imu.port {imu.port}; a "
                "port serves one device only"
            )
    return faults


def _key_faults(config: Config) -> list[str]:
    """Return a line for each key of a feed that cannot be read."""
    faults = []
    for i, bus in enumerate(config.buses):
        if bus.feed is not None and bus.feed.key_file is not None:
            try:
                read_key(config.resolve(bus.feed.key_file))
            except ConfigError as error:
                faults.append(f"buses.{i}.feed.key_file: {error}")
    return faults


def _mounting_warnings(config: Config) -> list[str]:
    place = config.imu.mounting.p_BS_m
    if hypot(*place) <= LONG_LEVER_M:
        return []
    return [
        f"imu.mounting.p_BS_m: {list(place)} is {hypot(*place):.0f} m from the base's origin; "
        f"above {LONG_LEVER_M:g} m is rather in millimetres"
    ]
