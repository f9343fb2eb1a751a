"""Scenarios: which bodies are in the plant, and which of them are unknown to the flight side.

A scenario file names the robot, the true bodies, the unknown ones, the trajectories, the sensor
models and the flight settings. Paths are relative to the file.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hil.world.contact import Contact
from hil.world.environment.config import EnvironmentSection
from hil.world.inertia import FloatArray, is_physical
from hil.world.sensor_config import SensorConfig
from hil.world.springs import Panel, SloshMass
from hil.world.stand import Stand
from hil.world.sudden import Sudden
from hil.world.thrusters import ThrusterSystem
from hil.world.wheels import WheelSystem
from hil.world.words import faults, other_kind, other_text

FOLDER = Path(__file__).parents[1] / "scenarios"
BODY_NAMES = ("base", "target")
BUS = "arm"  # name of the bus if a scenario names none


_T = TypeVar("_T")


class ScenarioError(ValueError):
    """A scenario cannot be used; the message names file, key and value."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class RobotSection(_Section):
    """The arm; its root link is the base and its tool frame grasps the target."""

    urdf: Path
    tool_frame: str


class TrajectorySection(_Section):
    """Files of two motions: for the identification, and for the judgement of the tool error."""

    identification: Path
    verification: Path
    sudden: Sudden | None = None  # what happens in the identification motion


class TimingSection(_Section):
    """Time at rest before and after the motion."""

    before_s: Annotated[float, Field(ge=0)]
    after_s: Annotated[float, Field(ge=0)]


class ModesSection(_Section):
    """1 sigma of the declared values of every mode of the base, and of its start amplitude."""

    mass_sigma_ratio: float
    frequency_sigma_ratio: float
    damping_sigma_ratio: float
    amplitude_m: float
    amplitude_rad: float


class FlightSection(_Section):
    """Settings of the flight software that do not follow from the devices."""

    bus: dict[str, Any]  # rate_hz, interface, channel, port: as `buses` of the configuration
    buses: dict[str, dict[str, Any]] = {}  # settings that differ from `bus`; empty: one bus "arm"
    tick_rate_hz: float
    torque_limit_nm: float
    speed_limit_rad_s: float
    sync_jitter_s: float  # 1 sigma of a SYNC's time stamp minus the latch, in real time
    estimator: dict[str, Any]  # section `estimator` of the configuration
    modes: ModesSection | None = None  # null: liquid and panels are not declared
    excitation: dict[str, Any] | None = None  # section `excitation` of the configuration


class FaultEntry(_Section):
    """One fault: its type (see `hil.faults.script.TYPES`), time, device and size."""

    type: str
    at_s: Annotated[float, Field(ge=0)]  # from power-on, which is the first SYNC
    for_s: Annotated[float, Field(gt=0)]
    device: Literal["arm", "imu", "star_tracker"] | None = None  # which, if a type suits several
    node_id: Annotated[int, Field(ge=1, le=127)] | None = None  # of the affected joint
    size: float | None = None  # amount of the fault, in the type's unit
    rate: Annotated[float, Field(gt=0, le=1)] | None = None  # share of affected frames or chunks


class Document(_Section):
    """A scenario file; `sensors`, `flight` and `environment` may be paths of files to include."""

    title: str
    robot: RobotSection
    bodies_file: Path
    bodies: dict[str, str]
    frames: dict[str, str] = {}  # frame to which each body besides base and target is fixed
    unknown: Annotated[tuple[str, ...], Field(min_length=1)]
    trajectories: TrajectorySection
    timing: TimingSection
    sensors: dict[str, Any] | Path
    flight: dict[str, Any] | Path
    environment: dict[str, Any] | Path | None = None  # null: nothing acts from outside
    faults: tuple[FaultEntry, ...] = ()
    slosh: tuple[SloshMass, ...] = ()  # liquid in the base
    panels: tuple[Panel, ...] = ()  # panels on hinges of the base
    stand: Stand | None = None  # null: the base floats freely
    wheels: WheelSystem | None = None  # reaction wheels that hold the base's attitude
    thrusters: ThrusterSystem | None = None  # thrusters of the base and their firings
    contact: Contact | None = None  # contact of the target with a fixture
    # w_NB_B at power-on: base, arm and target tumble as one body, the joints are at rest
    start_rate_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenario:
    """A scenario with its paths resolved; bodies as reports [m, c, I about the CoM]."""

    name: str
    title: str
    urdf: Path
    tool_frame: str
    truth: dict[str, FloatArray]
    frames: dict[str, str] = field(default_factory=dict)
    unknown: tuple[str, ...]
    identification: Path
    verification: Path
    sudden: Sudden | None = None
    before_s: float
    after_s: float
    sensors: dict[str, Any]
    flight: dict[str, Any]
    environment: EnvironmentSection | None = None
    faults: tuple[FaultEntry, ...] = ()
    slosh: tuple[SloshMass, ...] = ()
    panels: tuple[Panel, ...] = ()
    stand: Stand | None = None
    wheels: WheelSystem | None = None
    thrusters: ThrusterSystem | None = None
    contact: Contact | None = None
    start_rate_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def rests(self) -> bool:
        """Return whether the robot is at rest before and after the arm's motion.

        Liquid and panels swing on after it.
        """
        moved = (self.environment, self.wheels, self.thrusters, self.contact)
        swings = self.slosh or self.panels or any(self.start_rate_rad_s)
        return not swings and not any(part is not None for part in moved)

    @property
    def buses(self) -> dict[str, dict[str, Any]]:
        """Return the settings of every CAN bus by its name."""
        own = self.flight.get("buses") or {BUS: {}}
        return {name: {**self.flight["bus"], **settings} for name, settings in own.items()}

    @property
    def bus_ports(self) -> dict[str, int]:
        """Return the UDP port of every bus that has one."""
        buses = self.buses.items()
        return {name: int(bus["port"]) for name, bus in buses if bus.get("port") is not None}


def names(folder: Path = FOLDER) -> list[str]:
    """Return the names of the bench's scenarios, sorted."""
    return sorted(path.stem for path in folder.glob("*.yaml"))


def load(name: str, folder: Path = FOLDER) -> Scenario:
    """Read a scenario by name, or by the path of its file.

    Raises ScenarioError if there is no such scenario or the file is invalid.
    """
    path = _place(name, folder)
    home, document = path.parent, _document(path)
    catalogue = read_yaml(_file(path, "bodies_file", document.bodies_file))
    environment = None
    if document.environment is not None:
        section = _section(home, document.environment)
        environment = _validated(f"{path}: environment", EnvironmentSection.from_dict, section)
    missing = set(document.bodies.values()) - set(catalogue)
    if missing:
        raise ScenarioError(f"{path}: bodies: {sorted(missing)} not in {document.bodies_file}")
    unnamed = set(document.unknown) - set(document.bodies)
    if unnamed:
        raise ScenarioError(f"{path}: unknown: {sorted(unnamed)} not among bodies")
    if set(document.frames) != set(document.bodies) - set(BODY_NAMES):
        raise ScenarioError(
            f"{path}: frames: {sorted(document.frames)} must be the bodies besides base and target"
        )
    sensors, flight = _section(home, document.sensors), _section(home, document.flight)
    _check(f"{path}: ", sensors, flight)
    motions = document.trajectories
    return Scenario(
        name=path.stem,
        title=document.title,
        urdf=_file(path, "robot.urdf", document.robot.urdf),
        tool_frame=document.robot.tool_frame,
        truth={b: _body(catalogue[key], key) for b, key in document.bodies.items()},
        frames=document.frames,
        unknown=tuple(b for b in (*BODY_NAMES, *document.frames) if b in document.unknown),
        identification=_file(path, "trajectories.identification", motions.identification),
        verification=_file(path, "trajectories.verification", motions.verification),
        sudden=motions.sudden,
        before_s=document.timing.before_s,
        after_s=document.timing.after_s,
        sensors=sensors,
        flight=flight,
        environment=environment,
        faults=document.faults,
        slosh=document.slosh,
        panels=document.panels,
        stand=document.stand,
        wheels=document.wheels,
        thrusters=document.thrusters,
        contact=document.contact,
        start_rate_rad_s=document.start_rate_rad_s,
    )


def _place(name: str, folder: Path) -> Path:
    """Return the file of a scenario. Raises ScenarioError if there is none."""
    for place in (folder / f"{name}.yaml", Path(name)):
        if place.is_file():
            return place
    if name.endswith((".yaml", ".yml", ".urdf")) or "/" in name:
        raise ScenarioError(f"{name}: no such file")
    raise ScenarioError(f"no scenario {name!r}; there are {', '.join(names(folder))}")


def _document(path: Path) -> Document:
    """Return a validated scenario file. Raises ScenarioError with the kind of another file."""
    written = read_yaml(path)
    if kind := other_kind(written, Document):
        raise ScenarioError(f"{path}: is not a scenario but {kind}")
    return _validated(f"{path}", Document.model_validate, written)


def _validated(place: str, validate: Callable[[Any], _T], section: object) -> _T:
    """Return the validated section. Raises ScenarioError with a message of one line."""
    try:
        return validate(section)
    except ValidationError as error:
        model = getattr(validate, "__self__", None)  # `validate` is a method of the class
        raise ScenarioError(f"{place}: {faults(error, model)}") from error


def _file(scenario: Path, key: str, path: Path) -> Path:
    """Return the file that a key names. Raises ScenarioError if there is none."""
    found = (scenario.parent / path).resolve()
    if not found.is_file():
        raise ScenarioError(f"{scenario}: {key}: {path}: no such file")
    return found


def _check(prefix: str, sensors: dict[str, Any], flight: dict[str, Any]) -> None:
    """Raise ScenarioError for invalid keys and values of the sections `sensors` and `flight`."""
    _validated(f"{prefix}sensors", SensorConfig.from_dict, sensors)
    _validated(f"{prefix}flight", FlightSection.model_validate, flight)
    if not isinstance(flight["bus"].get("rate_hz"), int | float):
        raise ScenarioError(f"{prefix}flight.bus.rate_hz: missing; a number in hertz is needed")


def _body(entry: Mapping[str, Any], key: str) -> FloatArray:
    """Return a body's report (10,). Raises ScenarioError if it is incomplete or not physical."""
    try:
        report = report_from(entry)
    except (KeyError, TypeError, ValueError) as error:
        needed = "mass_kg, com_m (3) and inertia_kg_m2 (6)"
        raise ScenarioError(f"bodies: {key}: needs {needed}: {error!r}") from error
    if report.shape != (10,) or not is_physical(report):
        raise ScenarioError(f"bodies: {key}: no body has such mass and inertia about its centre")
    return report


def report_from(entry: Mapping[str, Any]) -> FloatArray:
    """Return the report (10,) of a mapping with mass_kg, com_m, inertia_kg_m2."""
    return np.array([entry["mass_kg"], *entry["com_m"], *entry["inertia_kg_m2"]], dtype=np.float64)


def mapping_from(report: FloatArray) -> dict[str, Any]:
    """Return mass_kg, com_m, inertia_kg_m2 of a report (10,); inverse of `report_from`."""
    values = [float(x) for x in report]
    return {"mass_kg": values[0], "com_m": values[1:4], "inertia_kg_m2": values[4:]}


def _section(home: Path, section: dict[str, Any] | Path) -> dict[str, Any]:
    return read_yaml(home / section) if isinstance(section, Path) else section


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping in a file. Raises ScenarioError if it is unreadable or not a mapping."""
    try:
        if kind := other_text(path):
            raise ScenarioError(f"{path}: is {kind}")
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ScenarioError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
    if not isinstance(document, dict):
        raise ScenarioError(f"{path}: must be a mapping")
    return document


def changed(scenario: Scenario, settings: Sequence[str]) -> Scenario:
    """Return the scenario with settings of its sensors, flight software or timing changed.

    Parameters
    ----------
    settings : KEY=VALUE each; KEY as `sensors.joints.torque_noise_nm`, VALUE as YAML.
        `timing.before_s` and `timing.after_s` are the times at rest before and after the motion,
        `trajectories.identification` and `trajectories.verification` the motions, and
        `trajectories.sudden`, as `{kind: stop, at_s: 20}`, what happens in the former

    Raises
    ------
    ScenarioError for a KEY outside these sections, and for a value that is not allowed.
    """
    sections: dict[str, Any] = {
        "sensors": deepcopy(scenario.sensors),
        "flight": deepcopy(scenario.flight),
        "timing": {"before_s": scenario.before_s, "after_s": scenario.after_s},
        "trajectories": {
            "identification": scenario.identification,
            "verification": scenario.verification,
            "sudden": scenario.sudden,
        },
    }
    for setting in settings:
        key, is_set, value = setting.partition("=")
        *path, last = key.split(".")
        place: Any = sections
        for name in path:
            place = place.get(name) if isinstance(place, dict) else None
        if not is_set or not path or path[0] not in sections:
            raise ScenarioError(
                f"--set {setting}: must be sensors.KEY=VALUE, flight.KEY=VALUE, timing.KEY=VALUE "
                "or trajectories.KEY=VALUE"
            )
        if not isinstance(place, dict):
            raise ScenarioError(f"--set {setting}: {_no_section(sections, path)}")
        try:
            place[last] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            words = " ".join(str(error).split())
            raise ScenarioError(f"--set {setting}: {words}") from error
    timing = _validated("--set timing", TimingSection.model_validate, sections.pop("timing"))
    motions = _validated(
        "--set trajectories", TrajectorySection.model_validate, sections.pop("trajectories")
    )
    _check("--set ", sections["sensors"], sections["flight"])
    return replace(scenario, **sections, **timing.model_dump(), **dict(motions))


def _no_section(sections: Mapping[str, Any], path: Sequence[str]) -> str:
    """Return a message with the first unknown name of a path and the sections that exist."""
    place: Any = sections
    for k, name in enumerate(path):
        inner = place.get(name)
        if not isinstance(inner, dict):
            above = ".".join(path[:k])
            found = ", ".join(key for key, value in place.items() if isinstance(value, dict))
            other = [key for key, section in sections.items() if name in section and key != above]
            hint = f"did you mean {other[0]}.{name}? " if other else ""
            return f"{above} has no section {name!r}; {hint}it has: {found or 'none'}"
        place = inner
    raise AssertionError(path)


def at_rates(scenario: Scenario, rate_hz: float, imu_rate_hz: int) -> Scenario:
    """Return a scenario with other rates [Hz] of bus, loop and inertial unit."""
    flight, sensors = dict(scenario.flight), dict(scenario.sensors)
    flight["bus"] = {**flight["bus"], "rate_hz": rate_hz}
    flight["tick_rate_hz"] = rate_hz
    sensors["imu"] = {**sensors["imu"], "rate_hz": imu_rate_hz}
    return replace(scenario, flight=flight, sensors=sensors)
