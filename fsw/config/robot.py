"""The robot: its known arm, and the bodies that are known or sought."""

from __future__ import annotations

from pathlib import Path
from typing import Self

from pydantic import model_validator

from fsw.config.base import (
    NonNegative,
    Positive,
    PositiveVector3,
    PositiveVector6,
    Section,
    Vector3,
    Vector6,
)


class RobotConfig(Section):
    """The known arm: a URDF whose root link is the base, and the frame that grasps."""

    urdf: Path
    tool_frame: str


class BodySigma(Section):
    """1-sigma of a body's prior: mass, centre of mass, inertia (xx xy xz yy yz zz)."""

    mass_kg: Positive
    com_m: PositiveVector3
    inertia_kg_m2: PositiveVector6


class LiquidConfig(Section):
    """Liquid that may move in a body on its own: what of the body's mass need not follow it."""

    mass_kg: Positive
    place_m: Vector3
    stroke_m: NonNegative = 0.0  # how far from there it may go


class BodyConfig(Section):
    """Inertial data of a body in its own frame, inertia about its centre of mass."""

    mass_kg: Positive
    com_m: Vector3
    inertia_kg_m2: Vector6
    sigma: BodySigma | None = None
    liquid: tuple[LiquidConfig, ...] = ()  # of an unknown body: widens what is published of it

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
