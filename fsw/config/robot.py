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
    """robot description: a tree of `revolute` or `prismatic` joints (further `fixed` ones are
    allowed) from the root link, which is the base B; one arm or several"""
    tool_frame: str
    """link or frame rigidly attached to the last link; the target's own frame E"""
    links_sigma_ratio: ScaleSigma = 0.05
    """how well the inertial data of links, and of a known base or target without `sigma`, are
    known: mass by this ratio, centre of mass by 0.7 of it times the body's radii, inertia
    accordingly. Weighed links: 0.01; a simulation that knows them: 0"""


class BaseConfig(Section):
    """Motion that the base can make, and gravity in the axes of B (zero for a free base)."""

    motion: Literal["free", "planar", "clamped"] = "free"
    """what holds the base: nothing, a level table, a bench"""
    normal_B: Vector3 = (0.0, 0.0, 1.0)
    """the table's normal in base axes, upwards, length 1; of `planar`"""
    gravity_B_m_s2: Gravity = (0.0, 0.0, 0.0)
    """gravity in base axes, measured by the accelerometer at rest (its sign changed) or given; on a
    table along its normal. A free base falls with it: leave it out"""

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
    """1 sigma of the prior mass"""
    com_m: PositionSigma
    """1 sigma of the prior centre of mass"""
    inertia_kg_m2: InertiaSigmas
    """1 sigma of the prior inertia, same order"""


class LiquidConfig(Section):
    """Liquid in a body: the part of its mass that may not follow a fast motion."""

    mass_kg: Mass
    """liquid of an unknown body that may move on its own: what of its mass a fast motion may leave
    behind. Widens what is published by as much, 1 sigma. All of it is less than the body's
    `mass_kg`"""
    place_m: Position
    """where it is, in the body's frame"""
    stroke_m: Length = 0.0
    """how far from there it may go, 1 sigma"""


class BodyConfig(Section):
    """Inertial data of a body in its frame; the inertia is about the centre of mass.

    The frame is the root link for `base`, `robot.tool_frame` for `target`, and `frame` for any
    other body.
    """

    frame: str | None = None
    """link or frame of the URDF that holds the body, for a body of any other name than `base` and
    `target`: a payload in a second arm. Two unknown bodies fixed to one another are refused"""
    mass_kg: Mass
    """mass; of an unknown body the prior's mean"""
    com_m: Position
    """centre of mass in the body's own frame: B for `base`, E for `target`, `frame` for any other
    """
    inertia_kg_m2: InertiaVector
    """xx xy xz yy yz zz, matrix elements (not products with the sign changed), about the centre of
    mass, in the axes of the body's frame; must be physically possible"""
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
