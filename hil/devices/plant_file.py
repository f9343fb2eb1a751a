"""The file of `python -m hil.devices`: robot, motion, sensors, links of a real-time plant."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml
from pydantic import TypeAdapter, ValidationError

from hil.devices.plant import Plant
from hil.world.contact import Contact
from hil.world.environment.config import EnvironmentSection
from hil.world.links import Body
from hil.world.robot import Robot
from hil.world.sensor_config import STRICT, SensorConfig
from hil.world.simulation import simulate_in
from hil.world.spline import JointSpline
from hil.world.springs import Panel, SloshMass
from hil.world.stand import Stand
from hil.world.thrusters import ThrusterSystem
from hil.world.wheels import WheelSystem
from hil.world.words import faults

TAIL_S = 0.1
TUMBLING_TAIL_S = 20.0  # longer than the rest of any run after the motion


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotFile:
    """The URDF of the true robot."""

    __pydantic_config__ = STRICT
    urdf: Path
    tool_frame: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueBodies:
    """True inertial data; base None: as in the URDF; target None: nothing is grasped."""

    __pydantic_config__ = STRICT
    base: Body | None = None
    target: Body | None = None
    held: dict[str, Body] = field(default_factory=dict)  # further bodies by frame


@dataclass(frozen=True, slots=True, kw_only=True)
class RedundantLink:
    """The second bus of a pair."""

    __pydantic_config__ = STRICT
    channel: str
    port: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class BusLink:
    """One python-can bus; nodes refer to it by `name`.

    `stamped_at` is the host's end of a SocketCAN cable, where SYNCs get their time stamps.
    """

    __pydantic_config__ = STRICT
    name: str
    interface: str
    channel: str
    stamped_at: str | None = None
    port: int | None = None
    fd: bool = False
    bitrate: int | None = None
    data_bitrate: int | None = None
    redundant: RedundantLink | None = None

    def lines(self) -> tuple[BusLink, ...]:
        """Return the bus, and the redundant bus if there is one, as separate buses."""
        if self.redundant is None:
            return (self,)
        second = self.redundant
        alone = replace(self, stamped_at=None, redundant=None)
        return self, replace(alone, channel=second.channel, port=second.port)


@dataclass(frozen=True, slots=True, kw_only=True)
class FeedLink:
    """Where the host receives the feed of the joints: UDP."""

    __pydantic_config__ = STRICT
    host: str
    port: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Links:
    """Buses and serial lines of the devices; the paths become links to pseudo-terminals."""

    __pydantic_config__ = STRICT
    buses: tuple[BusLink, ...]
    imu: Path | None = None
    star_tracker: Path | None = None
    feed: FeedLink | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Realtime:
    """Priority and processor of the process; priority 0: no SCHED_FIFO."""

    __pydantic_config__ = STRICT
    priority: int = 0
    cpu: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantFile:
    """The content of a plant file."""

    __pydantic_config__ = STRICT
    robot: RobotFile
    trajectory: Path
    sensors: SensorConfig
    links: Links
    bodies: TrueBodies = TrueBodies()
    environment: EnvironmentSection | None = None
    slosh: tuple[SloshMass, ...] = ()
    panels: tuple[Panel, ...] = ()
    stand: Stand | None = None
    wheels: WheelSystem | None = None
    thrusters: ThrusterSystem | None = None
    contact: Contact | None = None
    start_rate_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    start_delay_s: float = 4.0
    rate_hz: float = 500.0  # of the host's SYNC, or of drives that wait for none
    seed: int = 0
    realtime: Realtime = Realtime()


def load(path: Path) -> PlantFile:
    """Read the file. Raises ValueError with one line for unknown, missing or invalid keys."""
    data: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    try:
        return TypeAdapter(PlantFile).validate_python(data)
    except ValidationError as error:
        raise ValueError(faults(error, PlantFile)) from error


def build(file: PlantFile, folder: Path, t0_ns: int) -> Plant:
    """Simulate the truth; return devices powered on at `t0_ns`. Paths start at `folder`."""
    bodies = file.bodies
    urdf = folder / file.robot.urdf
    robot = Robot.load(
        urdf,
        file.robot.tool_frame,
        bodies.base,
        bodies.target,
        file.slosh,
        bodies.held,
        file.wheels,
        file.thrusters,
        file.panels,
    )
    spline = JointSpline.load(folder / file.trajectory)
    tumbles = any(file.start_rate_rad_s)
    moved = (file.environment, file.wheels, file.thrusters, file.contact)
    rests = not tumbles and all(part is None for part in moved)
    before_s = TAIL_S if rests else max(TAIL_S, file.start_delay_s)
    history = simulate_in(
        file.environment,
        robot,
        spline,
        -before_s,
        spline.duration_s
        + (TUMBLING_TAIL_S if tumbles or file.thrusters or file.contact else TAIL_S),
        stand=file.stand,
        w_NB_B_rad_s=file.start_rate_rad_s,
        contact=file.contact,
    )
    return Plant(
        history,
        file.sensors,
        file.seed,
        start_delay_s=file.start_delay_s,
        t0_ns=t0_ns,
        sync_rate_hz=file.rate_hz,
        thrusters=file.thrusters,
        sliding=robot.is_prismatic,
    )
