"""Section of modes: parts of the base on springs, such as a hinged panel or liquid in a tank."""

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from fsw.config.base import InertiaVector, Mass, Position, ScaleSigma, Section, Vector3
from fsw.config.joints import JointConfig
from fsw.config.processing import EstimatorConfig

METHODS_MODES = ("fused", "rda", "cm")
Frequency = Annotated[float, Field(ge=1e-4, le=1e3, allow_inf_nan=False)]
DampingRatio = Annotated[float, Field(ge=1e-6, lt=1, allow_inf_nan=False)]
LogSigma = Annotated[float, Field(ge=0, le=3.0, allow_inf_nan=False)]
Amplitude = Annotated[float, Field(gt=0, le=10.0, allow_inf_nan=False)]
TOLERANCE = 1e-6
CROSSWISE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class ModeConfig(Section):
    """One part of the base on springs and dampers; the data of the base include it at rest."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")]
    kind: Literal["panel", "slosh"]
    p_B_m: Position  # panel: a point of the hinge; liquid: the place at rest
    axes_B: Annotated[tuple[Vector3, ...], Field(min_length=1, max_length=3)] = CROSSWISE
    mass_kg: Mass  # of the moving part
    com_m: Position = (0.0, 0.0, 0.0)  # panel only: centre of mass, from p_B_m
    inertia_kg_m2: InertiaVector | None = None  # panel only: about its centre of mass
    frequency_hz: Frequency  # with the base held fixed
    damping_ratio: DampingRatio
    mass_sigma_ratio: ScaleSigma = 0.1
    frequency_sigma_ratio: LogSigma = 0.1
    damping_sigma_ratio: LogSigma = 0.5
    amplitude_m: Amplitude | None = None  # liquid only: 1 sigma of the distance from rest
    amplitude_rad: Amplitude | None = None  # panel only: 1 sigma of the angle from rest

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        import numpy as np

        is_panel, axes = self.kind == "panel", np.array(self.axes_B)
        if is_panel and len(axes) != 1:
            raise ValueError(f"axes_B: {len(axes)} axes; a panel has one, its hinge")
        if np.abs(axes @ axes.T - np.eye(len(axes))).max() > TOLERANCE:
            raise ValueError(
                f"axes_B: {axes.tolist()}; must each have length 1 and stand at right angles"
            )
        needed, other = ("rad", "m") if is_panel else ("m", "rad")
        if getattr(self, f"amplitude_{needed}") is None:
            raise ValueError(f"amplitude_{needed}: missing; kind: {self.kind} needs it")
        if (value := getattr(self, f"amplitude_{other}")) is not None:
            raise ValueError(
                f"amplitude_{other}: {value:g} is not of kind: {self.kind}, amplitude_{needed} is; "
                "leave it out"
            )
        if is_panel and self.inertia_kg_m2 is None:
            raise ValueError("inertia_kg_m2: missing; kind: panel needs it")
        if not is_panel and self.inertia_kg_m2 is not None:
            raise ValueError(
                f"inertia_kg_m2: {list(self.inertia_kg_m2)}; liquid is a point and has none; leave "
                "it out"
            )
        if not is_panel and any(self.com_m):
            raise ValueError(f"com_m: {list(self.com_m)}; liquid is a point at p_B_m; leave it out")
        if self.inertia_kg_m2 is not None:
            xx, xy, xz, yy, yz, zz = self.inertia_kg_m2
            moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            if moments[0] < 0 or moments[0] + moments[1] < moments[2] * (1.0 - TOLERANCE):
                raise ValueError(
                    f"inertia_kg_m2: {list(self.inertia_kg_m2)} is of no body: its principal "
                    f"moments {moments.round(6).tolist()} must be at least 0, each at most the sum "
                    "of the other two"
                )
            if np.linalg.norm(np.cross(self.com_m, axes[0])) ** 2 * self.mass_kg + moments[0] <= 0:
                raise ValueError(
                    f"inertia_kg_m2: {list(self.inertia_kg_m2)}; nothing turns about the hinge, "
                    "the inertia about it must be above 0"
                )
        return self

    @property
    def amplitude(self) -> float:
        """Return 1 sigma of the distance [m] or angle [rad] from rest."""
        return self.amplitude_m or self.amplitude_rad or 0.0


def modes_go_with(
    modes: Sequence[ModeConfig],
    joints: Sequence[JointConfig],
    estimator: EstimatorConfig,
    base_motion: str,
) -> None:
    """Raise ValueError if there are modes and joints, base, method or watch exclude them."""
    if not modes:
        return
    scaled = next((joint.name for joint in joints if joint.angle_scale_sigma_ratio), None)
    if scaled is not None:
        raise ValueError(
            f"joints[].angle_scale_sigma_ratio: of {scaled!r}; must be 0 where there are modes"
        )
    if base_motion != "free":
        raise ValueError(f"modes: base.motion is {base_motion}; they need a free base")
    if estimator.method not in METHODS_MODES:
        raise ValueError(
            f"estimator.method: {estimator.method!r} has no modes; must be "
            f"{', '.join(METHODS_MODES[:-1])} or {METHODS_MODES[-1]}"
        )
    if estimator.outside_wrench == "watch":
        raise ValueError("estimator.outside_wrench: 'watch' knows no modes; must be ignore")
