"""The user's own configuration on the bench: its file, with the bench's links, and its priors."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from fsw.commands.replay import replay
from fsw.config import Config, load
from fsw.config.text import read_yaml
from hil.judge.outcome import result_of
from hil.judge.score import Result
from hil.run.flight import URDF
from hil.run.own_devices import described
from hil.run.own_match import require_match
from hil.world.base_urdf import replace_base
from hil.world.inertia import FloatArray
from hil.world.prior import Prior
from hil.world.scenario import BODY_NAMES, Scenario, report_from


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
    ConfigError if a file is no configuration; ScenarioError if it does not match the world.
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
    for bus in document["buses"]:
        link = scenario.buses[bus["name"]]
        for key in ("bitrate", "data_bitrate"):
            bus.pop(key, None)
        bus |= {key: link[key] for key in ("interface", "channel")}
        bus["port"] = bus_ports.get(bus["name"])
        if bus.get("redundant") is not None:
            bus["redundant"] |= {key: link["redundant"].get(key) for key in ("channel", "port")}
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
            if key.get("file") is not None:
                key["file"] = str(config.resolve(Path(key["file"])).absolute())
    return dict(document)


def exact_result(exact: Config | None, recording: Path, unknown: Sequence[str]) -> Result | None:
    """Return what a recording gives with another configuration; None without one."""
    return None if exact is None else result_of(replay(recording, exact).estimate, unknown)
