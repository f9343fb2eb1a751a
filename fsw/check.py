"""Everything that can be wrong with a configuration, found before any device is opened.

`validate` is what `fsw run` and `fsw replay` go through; `fsw check` adds `describe`. Each fault is
one line: key, value found, bound.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from fsw import budget
from fsw.config import BusConfig, Config
from fsw.errors import ConfigError
from fsw.estimators.conditioning import EXTRA_POSITION_DEGREE
from fsw.estimators.inertia import PARAMETERS, pseudo_inertia
from fsw.estimators.model import RobotModel
from fsw.estimators.problem import Problem, build_problem
from fsw.messages import FloatArray

MIN_WINDOW_SAMPLES = 8  # of each channel, at the configured rate
FULL_LOAD = 1.0
HIGH_LOAD = 0.7
MAX_GROUP_DELAY_S = 0.1  # a sensor filter slower than 10 Hz is taken for milliseconds
MAX_SOCKET_PATH_BYTES = 107  # sun_path of Linux, less its final zero
SOCKET_NAME_BYTES = 20  # room for a slash and the control socket's own name
ROOT_LINK = "the root link"
SIMULATED_INTERFACES = ("udp_multicast", "virtual")  # have no bit rate of their own


def validate(config: Config) -> tuple[Problem, list[str]]:
    """Check a configuration without touching a device or writing a file.

    Returns
    -------
    The estimation problem laid out, and the warnings.

    Raises
    ------
    ConfigError with one line per fault.
    """
    faults = [
        *_window_faults(config),
        *_lag_faults(config),
        *_bus_faults(config),
        *_serial_faults(config),
    ]
    problem: Problem | None = None
    try:
        problem = _problem(config)
    except ConfigError as error:
        faults += str(error).splitlines()
    if faults or problem is None:
        raise ConfigError("\n".join(f"{config.name}: {fault}" for fault in faults))
    return problem, [*_warnings(config), *_inertia_warnings(config, problem.model)]


def validate_outputs(config: Config) -> None:
    """Check that recordings and state can be written where the configuration puts them.

    Raises
    ------
    ConfigError with one line per fault.
    """
    folders = {"service.state_directory": config.resolve(config.service.state_directory)}
    if config.recorder.directory is not None:
        folders["recorder.directory"] = config.resolve(config.recorder.directory)
    faults = [
        f"{key}: {folder} cannot be written: {why}"
        for key, folder in folders.items()
        if (why := _not_writable(folder))
    ]
    state = folders["service.state_directory"]
    used, bound = len(os.fsencode(state)), MAX_SOCKET_PATH_BYTES - SOCKET_NAME_BYTES
    if used > bound:
        faults.append(
            f"service.state_directory: {state} has {used} bytes; the control socket in it allows "
            f"at most {bound}"
        )
    if faults:
        raise ConfigError("\n".join(f"{config.name}: {fault}" for fault in faults))


def _warnings(config: Config) -> list[str]:
    found = []
    for i, bus in enumerate(config.buses):
        load = budget.bus_load(bus, config.joints)
        if load > HIGH_LOAD:
            found.append(
                f"buses.{i}.rate_hz: {bus.rate_hz:g} loads {bus.name!r} to {load:.0%} "
                f"{_bitrate_words(bus)}; above {HIGH_LOAD:.0%} late frames must be expected"
            )
        if all(joint.bus != bus.name for joint in config.joints):
            found.append(f"buses.{i}.name: no joint uses the bus {bus.name!r}")
    longest = budget.imu_load(config.imu)[1]
    if longest > FULL_LOAD:
        found.append(
            f"imu.baud_rate: {config.imu.baud_rate} does not carry the longest datagram at "
            f"{config.imu.rate_hz:g} Hz ({longest:.0%}); shorter ones fit"
        )
    cpus = os.cpu_count() or 1
    if config.scheduler.cpu is not None and config.scheduler.cpu >= cpus:
        found.append(f"scheduler.cpu: {config.scheduler.cpu} is not below this machine's {cpus}")
    return found


def missing_devices(config: Config) -> list[str]:
    """Return a line per serial port whose path does not exist now; nothing is opened."""
    ports = {"imu.port": config.imu.port}
    if config.star_tracker is not None:
        ports["star_tracker.port"] = config.star_tracker.port
    paths = {key: config.resolve(Path(port)) for key, port in ports.items() if "://" not in port}
    return [f"{key}: {path} does not exist now" for key, path in paths.items() if not path.exists()]


def _window_faults(config: Config) -> list[str]:
    estimator = config.estimator
    position_terms = estimator.nodes + EXTRA_POSITION_DEGREE
    channels = [
        (f"buses.{i}.rate_hz", bus.rate_hz, 2 * position_terms)
        for i, bus in enumerate(config.buses)
    ]
    channels.append(("imu.rate_hz", config.imu.rate_hz, 2 * estimator.nodes))
    faults = []
    for key, rate_hz, needed in channels:
        samples = rate_hz * estimator.window_s
        if samples < MIN_WINDOW_SAMPLES:
            faults.append(
                f"{key}: {rate_hz:g} gives {samples:.1f} samples in estimator.window_s "
                f"{estimator.window_s:g}; at least {MIN_WINDOW_SAMPLES} are needed"
            )
        elif samples * estimator.min_fill_ratio < needed:
            faults.append(
                f"{key}: {rate_hz:g} gives {samples:.1f} samples in estimator.window_s "
                f"{estimator.window_s:g}, of which estimator.min_fill_ratio "
                f"{estimator.min_fill_ratio:g} must be at least {needed}, twice the terms of the "
                f"polynomial for estimator.nodes {estimator.nodes}"
            )
    period_s = 1.0 / config.scheduler.tick_rate_hz
    if estimator.window_s < period_s:
        faults.append(
            f"estimator.window_s: {estimator.window_s:g} must be at least one tick, {period_s:g}"
        )
    return faults


def _lag_faults(config: Config) -> list[str]:
    scheduler, lag_s = config.scheduler, config.estimator.lag_s
    delays = {
        f"joints on buses.{i} (one cycle and one tick)": budget.joint_delay_s(bus, scheduler)
        for i, bus in enumerate(config.buses)
    }
    delays["imu (group delay, one sample, the line, one tick)"] = budget.imu_delay_s(
        config.imu, scheduler
    )
    if config.star_tracker is not None:
        delays["star_tracker (latency, the line, one tick)"] = budget.star_tracker_delay_s(
            config.star_tracker, scheduler
        )
    return [
        f"estimator.lag_s: {lag_s:g} is shorter than the delay of {source}; must be at least "
        f"{delay_s:.6f}"
        for source, delay_s in delays.items()
        if lag_s < delay_s
    ]


def _bitrate_words(bus: BusConfig) -> str:
    if bus.bitrate is None:
        return f"at an assumed {budget.ASSUMED_BITRATE} bit/s"
    return f"at buses.bitrate {bus.bitrate}"


def _bus_faults(config: Config) -> list[str]:
    faults = []
    for i, bus in enumerate(config.buses):
        load = budget.bus_load(bus, config.joints)
        simulated = bus.bitrate is None and bus.interface in SIMULATED_INTERFACES
        if load > FULL_LOAD and not simulated:
            faults.append(
                f"buses.{i}.rate_hz: {bus.rate_hz:g} loads {bus.name!r} to {load:.0%} "
                f"{_bitrate_words(bus)}; must be at most {FULL_LOAD:.0%}, worst-case bit stuffing "
                "included"
            )
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


def _serial_faults(config: Config) -> list[str]:
    faults = []
    imu, tracker = config.imu, config.star_tracker
    if imu.driver == "stim300" and imu.rate_hz not in budget.IMU_RATES_HZ:
        rates = ", ".join(f"{rate:g}" for rate in budget.IMU_RATES_HZ)
        faults.append(f"imu.rate_hz: {imu.rate_hz:g} must be one of {rates}")
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
    if tracker is not None:
        load = budget.star_tracker_load(tracker)
        if load > FULL_LOAD:
            faults.append(
                f"star_tracker.baud_rate: {tracker.baud_rate} cannot carry {tracker.rate_hz:g} "
                f"solutions a second; must be at least {round(load * tracker.baud_rate)}"
            )
        devices = {config.resolve(Path(port)).resolve() for port in (tracker.port, imu.port)}
        if len(devices) == 1:
            faults.append(
                f"star_tracker.port: {tracker.port} is the same device as imu.port {imu.port}; a "
                "port serves one device only"
            )
    return faults


def _problem(config: Config) -> Problem:
    urdf = config.resolve(config.robot.urdf)
    _check_urdf(urdf)
    model = RobotModel(urdf, config.robot.tool_frame)
    _check_masses(config, model)
    return build_problem(config, model)


def _check_urdf(urdf: Path) -> None:
    try:
        root = ET.fromstring(urdf.read_bytes())
    except OSError as error:
        raise ConfigError(f"robot.urdf: {urdf} cannot be read: {error.strerror}") from error
    except ET.ParseError as error:
        raise ConfigError(f"robot.urdf: {urdf} is no URDF: {error}") from error
    if root.tag != "robot":
        raise ConfigError(f"robot.urdf: {urdf} is no URDF: its root is <{root.tag}>, not <robot>")
    for joint in root.iter("joint"):
        kind = joint.get("type")
        if joint.find("parent") is not None and kind not in ("revolute", "fixed"):
            raise ConfigError(
                f"robot.urdf: joint {joint.get('name')!r} is {kind!r}; must be revolute or fixed"
            )


def _check_masses(config: Config, model: RobotModel) -> None:
    if model.n == 0:
        raise ConfigError("robot.urdf: 0 revolute joints; at least 1 is needed")
    for link, pi in _known_links(config, model):
        if pi[0] < 0.0 or (pi[0] == 0.0 and link == ROOT_LINK):
            bound = "positive, or bodies.base given" if link == ROOT_LINK else "at least 0"
            raise ConfigError(f"robot.urdf: {link} has mass {pi[0]:g} kg; must be {bound}")


def _inertia_warnings(config: Config, model: RobotModel) -> list[str]:
    return [
        f"robot.urdf: {link} (mass {pi[0]:g} kg) has an inertia that no body can have: principal "
        "moments must be positive, each at most the sum of the other two"
        for link, pi in _known_links(config, model)
        if pi[0] > 0.0 and not _possible(pi)
    ]


def _known_links(config: Config, model: RobotModel) -> list[tuple[str, FloatArray]]:
    """Return what the URDF says of every link that no section `bodies` replaces."""
    names = [ROOT_LINK, *(f"the link moved by {name!r}" for name in model.joint_names)]
    links = list(zip(names, model.pi_links.reshape(-1, PARAMETERS), strict=True))
    return links[1:] if "base" in config.bodies else links


def _possible(pi: FloatArray) -> bool:
    """Tell whether a body can have these parameters; point masses and thin rods can."""
    moments = np.linalg.eigvalsh(pseudo_inertia(pi))
    return bool(moments[0] >= -1e-9 * moments[-1])


def _not_writable(folder: Path) -> str:
    """Return why a folder, which need not exist yet, takes no file; empty when it does."""
    nearest = folder
    while not nearest.exists() and nearest != nearest.parent:
        nearest = nearest.parent
    if not nearest.is_dir():
        return f"{nearest} is not a directory"
    if not os.access(nearest, os.W_OK | os.X_OK):
        return f"{nearest} does not permit it"
    return ""
