"""The robot: its known arm, and the bodies that are known or sought."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from fsw.config.base import (
    InertiaSigmas,
    InertiaVector,
    Length,
    Mass,
    MassSigma,
    Position,
    PositionSigma,
    ScaleSigma,
    Section,
)


class RobotConfig(Section):
    """The known arm: a URDF whose root link is the base, and the frame that grasps."""

    urdf: Path
    tool_frame: str
    links_sigma_ratio: ScaleSigma = 0.05  # of the known bodies' inertial data; 0: they are exact


class BodySigma(Section):
    """1-sigma of a body's prior: mass, centre of mass, inertia (xx xy xz yy yz zz)."""

    mass_kg: MassSigma
    com_m: PositionSigma
    inertia_kg_m2: InertiaSigmas


class LiquidConfig(Section):
    """Liquid that may move in a body on its own: what of the body's mass need not follow it."""

    mass_kg: Mass
    place_m: Position
    stroke_m: Length = 0.0  # how far from there it may go


class BodyConfig(Section):
    """Inertial data of a body in its own frame, inertia about its centre of mass.

    That frame is the root link's for `base`, `robot.tool_frame` for `target`, and `frame` for a
    body of any other name.
    """

    frame: str | None = None  # link or frame of the URDF
    mass_kg: Mass
    com_m: Position
    inertia_kg_m2: InertiaVector
    sigma: BodySigma | None = None
    liquid: Annotated[
        tuple[LiquidConfig, ...], Field(max_length=16)
    ] = ()  # of an unknown body: widens what is published of it

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
        return self
