"""The mapping file of `fsw import`, which states quantity and unit of the columns of a table."""

from math import pi
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, ValidationError

from fsw.config import Finite, Section
from fsw.config.constants import STANDARD_GRAVITY_M_S2
from fsw.config.text import TextError, explain, must_be, read_yaml
from fsw.errors import ConfigError

FACTORS = {
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "iso": 1.0,
    "rad": 1.0,
    "deg": pi / 180.0,
    "m": 1.0,
    "mm": 1e-3,
    "N m": 1.0,
    "mN m": 1e-3,
    "N": 1.0,
    "mN": 1e-3,
    "rad/s": 1.0,
    "deg/s": pi / 180.0,
    "m/s2": 1.0,
    "g": STANDARD_GRAVITY_M_S2,
    "1": 1.0,
}


def _listed(value: object) -> object:
    return value if value is None or isinstance(value, list | tuple) else (value,)


def _name(value: object) -> object:
    """Return a column's number as its text."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


Column = Annotated[str, BeforeValidator(_name)]  # name, or number from 1 on


class TimeColumn(Section):
    """Column and unit of the samples' stamps."""

    column: Column
    unit: Literal["s", "ms", "us", "ns", "iso"]  # iso: date and time as ISO 8601 has them


class Quantity(Section):
    """Columns of one quantity; in a single name, `{}` stands for each joint, wheel or axis.

    A unit, scale or sign that is not a list applies to all columns.
    """

    file: Path | None = None  # with the same rows as the section's file; None: the section's file
    columns: Annotated[tuple[Column, ...], BeforeValidator(_listed)]
    unit: str | tuple[str, ...]
    scale: Annotated[tuple[Finite, ...], BeforeValidator(_listed)] = (1.0,)
    sign: Annotated[tuple[Literal[-1, 1], ...], BeforeValidator(_listed)] = (1,)

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of all columns, or of each."""
        return (self.unit,) if isinstance(self.unit, str) else tuple(self.unit)


def _one_of(*units: str) -> BeforeValidator:
    """Return a validator of units for joints of both kinds, or of a list of them."""

    def check(value: object) -> tuple[str, ...]:
        listed = tuple(value) if isinstance(value, list | tuple) else (value,)
        if not listed or any(unit not in units for unit in listed):
            raise ValueError(f"must be {', '.join(map(repr, units[:-1]))} or {units[-1]!r}")
        return listed

    return BeforeValidator(check)


class Angles(Quantity):
    """Joint positions, in units of rotation for revolute joints, of length for prismatic ones."""

    unit: Annotated[tuple[str, ...], _one_of("rad", "deg", "m", "mm")]
    wraps: Annotated[tuple[bool, ...] | None, BeforeValidator(_listed)] = None  # None: by the data


class Torques(Quantity):
    """Link-side torques of revolute joints, forces of prismatic ones."""

    unit: Annotated[tuple[str, ...], _one_of("N m", "mN m", "N", "mN")]


class Rates(Quantity):
    """Angular velocity in the axes of the inertial unit."""

    unit: Literal["rad/s", "deg/s"]


class Forces(Quantity):
    """Specific force in the axes of the inertial unit; at rest on the ground it points up."""

    unit: Literal["m/s2", "g"]


class Attitude(Quantity):
    """Quaternions of the star tracker; `order` is the order of the columns."""

    unit: Literal["1"] = "1"
    order: Literal["xyzw", "wxyz"]


class Source(Section):
    """Keys that every sensor has; None: file of the command line, time of the whole mapping."""

    file: Annotated[tuple[Path, ...] | None, BeforeValidator(_listed)] = None  # one, or its parts
    time: TimeColumn | None = None


class Joints(Source):
    """All joints; `order` names the joints in the order of the columns; None: as configured.

    With `poses` every row is a pose at rest, and the table needs no time.
    """

    order: tuple[str, ...] | None = None
    position: Angles
    torque: Torques | None = None
    poses: bool = False


class Imu(Source):
    """Columns of the inertial unit."""

    rate: Rates
    specific_force: Forces | None = None


class Speeds(Quantity):
    """Speeds of rotors relative to the base."""

    unit: Literal["rad/s", "deg/s"]


class Wheels(Source):
    """All reaction wheels, in the order of the configuration."""

    speed: Speeds


class SensedForces(Quantity):
    """Forces of wrench sensors."""

    unit: Annotated[tuple[str, ...], _one_of("N", "mN")]


class SensedTorques(Quantity):
    """Moments of wrench sensors."""

    unit: Annotated[tuple[str, ...], _one_of("N m", "mN m")]


class WrenchSensors(Source):
    """All wrench sensors, in the order of the configuration: x, y and z of each in its axes."""

    force: SensedForces
    torque: SensedTorques


class StarTracker(Source):
    """Columns of the star tracker."""

    quaternion: Attitude


class Mapping(Section):
    """Content of a mapping file: sections of the sensors, and their common time."""

    time: TimeColumn | None = None
    joints: Joints | None = None
    wrench_sensors: WrenchSensors | None = None
    wheels: Wheels | None = None
    imu: Imu | None = None
    star_tracker: StarTracker | None = None

    @property
    def sections(self) -> dict[str, Source]:
        """The sections that the file contains, by name of their source."""
        return {name: section for name, section in self if isinstance(section, Source)}

    def time_of(self, name: str, section: Source) -> TimeColumn:
        """Return the column of a source's stamps. Raises ConfigError if none is mapped."""
        found = section.time or self.time
        if found is None:
            raise ConfigError(f"{name}.time: missing, and there is no time for all")
        return found


def read_mapping(path: Path) -> Mapping:
    """Read a mapping file.

    Raises
    ------
    ConfigError with one line per fault, which names key, value and bound.
    """
    try:
        source = path.read_bytes()
        must_be(source, str(path), "a mapping as docs/import.md has it")
        return Mapping.model_validate(read_yaml(source, aliases=True))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except TextError as error:
        raise ConfigError(f"{path}: {error}") from error
    except ValidationError as error:
        lines = [f"{path}: {line}" for line in explain(Mapping, error)]
        raise ConfigError("\n".join(lines)) from error
