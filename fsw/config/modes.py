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
    """its name in the state: `mode_frequency.NAME`"""
    kind: Literal["panel", "slosh"]
    """`panel`: a body that turns about a hinge; `slosh`: a point mass that slides along axes"""
    p_B_m: Position
    """a point of the hinge; liquid: where it is at rest; base axes"""
    axes_B: Annotated[tuple[Vector3, ...], Field(min_length=1, max_length=3)] = CROSSWISE
    """unit vectors at right angles, base axes: the hinge (one), or the directions of the liquid (up
    to three)"""
    mass_kg: Mass
    """of what moves"""
    com_m: Position = (0.0, 0.0, 0.0)
    """of a panel, from `p_B_m`, base axes"""
    inertia_kg_m2: InertiaVector | None = None
    """of a panel, about its centre of mass, base axes; liquid has none"""
    frequency_hz: Frequency
    """with the base held. Above `estimator.nodes` / (4 `estimator.window_s`), 2.5 Hz by default,
    the nodes of a window do not follow the swing, and `fsw check` warns"""
    damping_ratio: DampingRatio
    """of critical, with the base held"""
    mass_sigma_ratio: ScaleSigma = 0.1
    """1 sigma of the mass; a panel's inertia goes with it. 0: exact"""
    frequency_sigma_ratio: LogSigma = 0.1
    """1 sigma of the logarithm of the frequency. 0: exact"""
    damping_sigma_ratio: LogSigma = 0.5
    """1 sigma of the logarithm of the damping ratio. 0: exact"""
    amplitude_m: Amplitude | None = None
    """of liquid, required: 1 sigma of its distance from rest when identification begins; its speed
    then is as much times 2 pi `frequency_hz`"""
    amplitude_rad: Amplitude | None = None
    """of a panel, required"""

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
