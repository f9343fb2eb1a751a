"""Section of thrusters: valves on the base whose reported firings are known inputs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from fsw.config.base import (
    SLOWEST_HZ,
    UNIT_TOLERANCE,
    NodeId,
    Position,
    Rate,
    ScaleSigma,
    Section,
    Vector3,
)
from fsw.config.signals import Role, SignalConfig, TimingConfig, has_its_keys, is_described

Thrust = Annotated[float, Field(ge=1e-6, le=1e5, allow_inf_nan=False)]
ValveTime = Annotated[float, Field(ge=1e-4, le=0.5, allow_inf_nan=False)]
ValveDelay = Annotated[float, Field(ge=0, le=1.0, allow_inf_nan=False)]
ValveSigma = Annotated[float, Field(ge=0, le=1.0, allow_inf_nan=False)]


class ThrusterConfig(Section):
    """One thruster: a valve of a CAN node, and the force on the base while the valve is open."""

    width: ClassVar = 2  # values of a sample: is_open (NaN: a change may be missing), is_change
    kind: ClassVar = "revolute"
    late_s: ClassVar = 0.0  # of its readings; `delay_s` is the force's
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")]
    """its name in events and status"""
    driver: Literal["canopen", "described"] = "canopen"
    """`canopen`: the tailored node of [icd.md](icd.md); `described`: any device, by `signals` and
    `timing` ([how](howto/connect.md))"""
    bus: str
    """name of the bus the node is on"""
    node_id: NodeId | None = None
    """CANopen node that drives the valve; with `described`, where `description` is"""
    description: Path | None = None
    """EDS or DCF file of this node"""
    signals: dict[Role, SignalConfig] | None = None  # for driver: described
    timing: TimingConfig | None = None  # likewise
    valve: int = Field(default=0, ge=0, le=15)
    """its bit in the tailored node's valve word"""
    rate_hz: Rate
    """rate of the node's reports, at least 1 and at most the bus's SYNC rate"""
    p_B_m: Position
    """where the force acts, base axes"""
    direction_B: Vector3
    """unit vector of the force on the base (against the jet), base axes"""
    force_n: Thrust
    """nominal force once it has risen"""
    force_sigma_ratio: ScaleSigma = 0.03
    """1 sigma of that force; half of its variance is taken as common to all thrusters (one
    pressure). 0: it is exact"""
    delay_s: ValveDelay = 0.005
    """from the change of the valve as reported to the change of the force"""
    delay_sigma_s: ValveSigma = 0.0
    """1 sigma of it; 0: it is exact"""
    rise_s: ValveTime = 0.01
    """time constant with which the force rises and falls"""
    rise_sigma_s: ValveSigma = 0.0
    """1 sigma of it; 0: it is exact"""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        length = sum(x * x for x in self.direction_B) ** 0.5
        if not abs(length - 1.0) <= UNIT_TOLERANCE:
            raise ValueError(
                f"direction_B: {list(self.direction_B)} has length {length:.4g}; must have length 1"
            )
        roles: list[Role] = ["valve", "on_time" if "on_time" in (self.signals or {}) else "age"]
        found = is_described(self, roles, "a valve")
        has_its_keys(self, {"node_id": not found or self.description is not None})
        if self.rate_hz < SLOWEST_HZ:
            raise ValueError(f"rate_hz: {self.rate_hz:g} must be at least {SLOWEST_HZ:g}")
        return self


def thrusters_go_with(
    thrusters: Sequence[ThrusterConfig], *, attitude: bool, base_motion: str
) -> None:
    """Raise ValueError for thrusters on an unsuitable base, or one node at two rates."""
    if not thrusters:
        return
    if not attitude or base_motion != "free":
        found = "without a star_tracker" if not attitude else f"with base.motion: {base_motion}"
        raise ValueError(f"thrusters: {found}; they need a star_tracker and base.motion: free")
    nodes: dict[str, float] = {}
    for i, thruster in enumerate(thrusters):
        if thruster.driver != "canopen":
            continue
        node = f"{thruster.bus}:{thruster.node_id}"
        rate_hz = nodes.setdefault(node, thruster.rate_hz)
        if rate_hz != thruster.rate_hz:
            raise ValueError(
                f"thrusters.{i}.rate_hz: {thruster.rate_hz:g} must be {rate_hz:g}, as of the other "
                f"thrusters on node 0x{thruster.node_id:02x}"
            )
