"""The user's own configuration on the bench: its file, with the bench's links, and its priors."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from fsw.config import Config, load
from fsw.config.text import read_yaml
from hil.judge.outcome import result_of
from hil.judge.score import Result
from hil.run.flight import URDF
from hil.run.own_devices import FD_RATES, described
from hil.run.own_match import require_match
from hil.world.base_urdf import replace_base
from hil.world.inertia import FloatArray
from hil.world.prior import Prior
from hil.world.scenario import BODY_NAMES, Scenario, report_from
from offline.replay import replay

FEED_LINK = {"interface": "samples", "channel": "127.0.0.1"}


class _Inertial(Protocol):
    mass_kg: Any
    com_m: Any
    inertia_kg_m2: Any


def own_world(
    scenario: Scenario, path: Path | None, devices: Path | None, seed: int, folder: Path
) -> tuple[Scenario, Config | None]:
    """Return a world with the devices that a configuration describes, and the configuration.

    Parameters
    ----------
    path : the configuration that flies; None: the world stays as it is
    devices : the configuration that describes the devices; None: the one that flies
    folder : where the drawn URDF of the world is written

    Raises
    ------
    ConfigError if a file is not a configuration; ScenarioError if it does not match the world.
    """
    if path is None:
        return scenario, None
    config = load(path)
    told = config if devices is None else load(devices)
    for one in (config, told):
        require_match(scenario, one)
    unknown = tuple(b for b in (*BODY_NAMES, *scenario.frames) if b in config.unknown)
    return described(scenario, told, unknown, seed, folder), config


def own_priors(config: Config) -> dict[str, Prior]:
    """Return the priors of the unknown bodies."""
    bodies = {name: config.bodies[name] for name in config.unknown}
    return {
        name: Prior(report=_report(body), sigma=_report(body.sigma))
        for name, body in bodies.items()
        if body.sigma is not None
    }


def _report(body: _Inertial) -> FloatArray:
    return report_from({key: getattr(body, key) for key in _Inertial.__annotations__})


def own_document(
    config: Config,
    scenario: Scenario,
    folder: Path,
    bus_ports: Mapping[str, int],
    overrides: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the configuration as its file has it, on the bench's buses, lines and folders.

    If the base is unknown, the robot's file gets its prior, as `write_flight` does.
    """
    document: Any = read_yaml(config.source, aliases=True)
    urdf = config.resolve(config.robot.urdf).absolute()
    if "base" in config.unknown:
        text = replace_base(urdf, own_priors(config)["base"].report)
        urdf = folder / URDF
        urdf.write_text(text, encoding="utf-8")
    document["robot"]["urdf"] = str(urdf)
    for bus, told in zip(document["buses"], config.buses, strict=True):
        link = scenario.buses[bus["name"]]
        for key in ("bitrate", "data_bitrate"):
            bus.pop(key, None)
        bus.update(FD_RATES if told.fd else {})
        bus.update({key: link[key] for key in ("interface", "channel")})
        bus["port"] = bus_ports.get(bus["name"])
        bus.update(FEED_LINK if told.feed is not None else {})
        own_file(bus, "description", config)
        own_file(bus.get("feed") or {}, "key_file", config)
        if bus.get("redundant") is not None:
            bus["redundant"] |= {key: link["redundant"].get(key) for key in ("channel", "port")}
    for joint in document["joints"]:
        own_file(joint, "description", config)
    for device in ("imu", "star_tracker"):
        if device in scenario.sensors:
            document[device]["port"] = str(folder.absolute() / device)
    document["estimator"] = (document.get("estimator") or {}) | dict(overrides)
    document["recorder"] = (document.get("recorder") or {}) | {"directory": "recording"}
    document["service"] = (document.get("service") or {}) | {"state_directory": "state"}
    if config.excitation is not None:
        document["excitation"]["limits"] = str(config.resolve(config.excitation.limits).absolute())
    if config.telemetry is not None and config.telemetry.sdls is not None:
        for key in document["telemetry"]["sdls"]["keys"]:
            own_file(key, "file", config)
    return dict(document)


def own_file(section: dict[str, Any], key: str, config: Config) -> None:
    """Make the path of a section absolute, where there is one."""
    if section.get(key) is not None:
        section[key] = str(config.resolve(Path(section[key])).absolute())


def exact_result(exact: Config | None, recording: Path, unknown: Sequence[str]) -> Result | None:
    """Return what a recording gives with another configuration; None without one."""
    return None if exact is None else result_of(replay(recording, exact).estimate, unknown)
