"""Sections of the robot: its known arm, its base, and known or unknown bodies."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from fsw.config.base import (
    Gravity,
    InertiaSigmas,
    InertiaVector,
    Length,
    Mass,
    MassSigma,
    Position,
    PositionSigma,
    ScaleSigma,
    Section,
    Vector3,
)

METHODS_HELD = {"planar": ("fused", "rda", "cm"), "clamped": ("fused", "rda")}
LEVEL_M_S2 = 1e-3  # largest component of gravity along a level table


class RobotConfig(Section):
    """The known arm: a URDF whose root link is the base, and the frame that grasps the target."""

    urdf: Path
    tool_frame: str
    links_sigma_ratio: ScaleSigma = 0.05  # of inertial data of known bodies; 0: exact


class BaseConfig(Section):
    """Motion that the base can make, and gravity in the axes of B (zero for a free base)."""

    motion: Literal["free", "planar", "clamped"] = "free"
    normal_B: Vector3 = (0.0, 0.0, 1.0)  # upward normal of a planar base's table
    gravity_B_m_s2: Gravity = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        import numpy as np

        normal, gravity = np.array(self.normal_B), np.array(self.gravity_B_m_s2)
        if not abs(np.linalg.norm(normal) - 1.0) <= 1e-6:
            raise ValueError(f"normal_B {list(self.normal_B)}: must have length 1")
        if self.motion == "free" and gravity.any():
            raise ValueError("gravity_B_m_s2: a free base falls with it; leave it out")
        if self.motion == "planar" and np.linalg.norm(np.cross(normal, gravity)) > LEVEL_M_S2:
            raise ValueError("gravity_B_m_s2: must be along normal_B; a table is level")
        return self


class BodySigma(Section):
    """1 sigma of a body's prior: mass, centre of mass, inertia (xx xy xz yy yz zz)."""

    mass_kg: MassSigma
    com_m: PositionSigma
    inertia_kg_m2: InertiaSigmas


class LiquidConfig(Section):
    """Liquid in a body: the part of its mass that may not follow a fast motion."""

    mass_kg: Mass
    place_m: Position  # in the frame of the body
    stroke_m: Length = 0.0  # 1 sigma of the distance from place_m


class BodyConfig(Section):
    """Inertial data of a body in its frame; the inertia is about the centre of mass.

    The frame is the root link for `base`, `robot.tool_frame` for `target`, and `frame` for any
    other body.
    """

    frame: str | None = None  # link or frame of the URDF
    mass_kg: Mass
    com_m: Position
    inertia_kg_m2: InertiaVector
    sigma: BodySigma | None = None
    liquid: Annotated[
        tuple[LiquidConfig, ...], Field(max_length=16)
    ] = ()  # of an unknown body: increases its published sigmas

    @model_validator(mode="after")
    def _physical(self) -> Self:
        import numpy as np

        xx, xy, xz, yy, yz, zz = self.inertia_kg_m2
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if moments[0] <= 0 or moments[0] + moments[1] < moments[2]:
            raise ValueError(
                f"inertia_kg_m2 {list(self.inertia_kg_m2)} is not physically possible: its "
                f"principal moments {moments.round(6).tolist()} must be positive and each at most "
                "the sum of the other two"
            )
        liquid_kg = sum(part.mass_kg for part in self.liquid)
        if liquid_kg >= self.mass_kg:
            raise ValueError(
                f"liquid: {liquid_kg:g} kg in all must be below mass_kg {self.mass_kg:g}, which "
                "includes it"
            )
        return self
