"""The section `environment` of a scenario: an orbit, and what of it acts."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
Ratio = Annotated[float, Field(ge=0, le=1)]
Vector3 = tuple[float, float, float]
Activity = Literal["low", "moderate", "high"]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class OrbitSection(_Section):
    """A circular orbit and where the robot is on it when the motion starts (t = 0)."""

    altitude_m: Positive
    inclination_rad: float = 0.0
    ascending_node_rad: float = 0.0  # right ascension
    latitude_argument_rad: float = 0.0  # angle from the ascending node at t = 0
    epoch_utc: str = "2013-09-04T12:00:00"  # of t = 0: places Sun and Moon


class AtmosphereSection(_Section):
    """Free molecular flow on flat plates; density by JB2006."""

    activity: Activity = "moderate"
    density: Literal["table", "orekit"] = "table"  # embedded, or computed now (extra `orekit`)
    density_kg_m3: Positive | None = None  # this constant density instead
    normal_accommodation_ratio: Ratio = 1.0
    tangential_accommodation_ratio: Ratio = 0.3
    temperature_k: Positive = 1000.0  # of the air
    wall_temperature_k: Positive = 300.0
    molar_mass_kg_mol: Positive = 0.016  # atomic oxygen, what prevails at 500 km


class RadiationSection(_Section):
    """Sunlight on flat plates; what is neither absorbed nor mirrored is scattered."""

    absorbed_ratio: Ratio = 0.5
    mirrored_ratio: Ratio = 0.5


class CuboidSection(_Section):
    """Outer surfaces of a body in its own axes; null: those of the uniform cuboid it weighs as."""

    size_m: Vector3 | None = None
    centre_m: Vector3 | None = None  # in the body's frame; null: its centre of mass


class EnvironmentSection(_Section):
    """What acts on the robot; a part of null or false does not."""

    orbit: OrbitSection
    gravity_gradient: bool = False
    third_body: bool = False
    atmosphere: AtmosphereSection | None = None
    solar_pressure: RadiationSection | None = None
    surfaces: dict[Literal["base", "target"], CuboidSection] = {}
    attitude_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)  # R_NB at the start
    told_to_flight: bool = True  # the orbit stands in the flight configuration

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> EnvironmentSection:
        """Validate a YAML mapping; ValueError (pydantic's) for unknown, missing or wrong keys."""
        return cls.model_validate(data)
