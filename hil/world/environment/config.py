"""The section `environment` of a scenario: an orbit, and the effects that act."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

TABLE_FROM_M = 300e3  # lowest altitude of the embedded density table
UNIT_TOLERANCE = 1e-6

Positive = Annotated[float, Field(gt=0)]
Ratio = Annotated[float, Field(ge=0, le=1)]
Vector3 = tuple[float, float, float]
Activity = Literal["low", "moderate", "high"]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class OrbitSection(_Section):
    """A circular orbit and where the robot is on it when the motion starts (t = 0)."""

    altitude_m: Positive
    inclination_rad: float = 0.0
    ascending_node_rad: float = 0.0  # right ascension
    latitude_argument_rad: float = 0.0  # angle from the ascending node at t = 0
    epoch_utc: str = "2013-09-04T12:00:00"  # time t = 0, for the places of Sun and Moon

    @field_validator("epoch_utc")
    @classmethod
    def _is_utc(cls, text: str) -> str:
        if datetime.fromisoformat(text).utcoffset():
            raise ValueError("must be UTC, without an offset")
        return text


class AtmosphereSection(_Section):
    """Free molecular flow on flat plates; density by JB2006."""

    activity: Activity = "moderate"
    density: Literal["table", "orekit"] = "table"  # embedded table, or Orekit (extra `orekit`)
    density_kg_m3: Positive | None = None  # constant density instead of JB2006
    normal_accommodation_ratio: Ratio = 1.0
    tangential_accommodation_ratio: Ratio = 0.3
    temperature_k: Positive = 1000.0  # of the air
    wall_temperature_k: Positive = 300.0
    molar_mass_kg_mol: Positive = 0.016  # atomic oxygen, which prevails at 500 km


class RadiationSection(_Section):
    """Sunlight on flat plates; light that is neither absorbed nor mirrored is scattered."""

    absorbed_ratio: Ratio = 0.5
    mirrored_ratio: Ratio = 0.5

    @model_validator(mode="after")
    def _no_more_than_all(self) -> Self:
        if self.absorbed_ratio + self.mirrored_ratio > 1.0:
            raise ValueError("absorbed_ratio and mirrored_ratio must not exceed 1 together")
        return self


class CuboidSection(_Section):
    """Outer surfaces of a body, in body axes; null: a uniform cuboid with the body's moments."""

    size_m: tuple[Positive, Positive, Positive] | None = None
    centre_m: Vector3 | None = None  # in the body's frame; null: its centre of mass


class EnvironmentSection(_Section):
    """Forces that act on the robot; null or false switches an effect off."""

    orbit: OrbitSection
    gravity_gradient: bool = False
    third_body: bool = False
    atmosphere: AtmosphereSection | None = None
    solar_pressure: RadiationSection | None = None
    surfaces: dict[Literal["base", "target"], CuboidSection] = {}
    attitude_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)  # R_NB at the start
    told_to_flight: bool = True  # the flight configuration has the orbit

    @field_validator("attitude_xyzw")
    @classmethod
    def _is_unit(cls, q: tuple[float, ...]) -> tuple[float, ...]:
        if abs(math.hypot(*q) - 1.0) > UNIT_TOLERANCE:
            raise ValueError("must have norm 1")
        return q

    @model_validator(mode="after")
    def _has_a_density(self) -> Self:
        air, altitude_m = self.atmosphere, self.orbit.altitude_m
        by_table = air is not None and air.density == "table" and air.density_kg_m3 is None
        if by_table and altitude_m < TABLE_FROM_M:
            raise ValueError(
                f"orbit.altitude_m {altitude_m:g} is below the density table's {TABLE_FROM_M:g}; "
                "atmosphere.density: orekit has no such limit"
            )
        return self

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> EnvironmentSection:
        """Validate a YAML mapping. Raises pydantic's ValueError for invalid or missing keys."""
        return cls.model_validate(data)
