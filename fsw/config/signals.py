"""Sections that describe frames of any CAN device, and say which of their signals it uses."""

from collections.abc import Collection, Mapping
from math import pi, tau
from pathlib import Path
from typing import Annotated, Literal, Protocol, Self

from pydantic import Field, model_validator

from fsw.config.base import Delay, Duration, Finite, Positive, Section
from fsw.config.constants import STANDARD_GRAVITY_M_S2
from fsw.errors import brief

Name = Annotated[str, Field(min_length=1, max_length=128)]
Identifier = Annotated[int, Field(ge=0, le=0x1FFFFFFF)]
BY_SYNC = ("echoed_counter", "last_sync")
DESCRIBED = "described"  # driver of a device whose frames a description gives
G = STANDARD_GRAVITY_M_S2
StampSigma = Annotated[float, Field(ge=0, le=0.1, allow_inf_nan=False)]
# SI units of one unit, by what is measured; spelled without spaces and in lower case
UNITS: dict[str, dict[str, float]] = {
    "position": {
        "rad": 1.0, "mrad": 1e-3, "deg": pi / 180, "mdeg": pi / 180e3, "0.001deg": pi / 180e3,
        "0.01deg": pi / 18e3, "rev": tau, "turn": tau, "turns": tau,
    },
    "speed": {
        "rad/s": 1.0, "mrad/s": 1e-3, "deg/s": pi / 180, "rev/s": tau, "turn/s": tau,
        "rpm": tau / 60, "rev/min": tau / 60,
    },
    "torque": {"nm": 1.0, "mnm": 1e-3, "unm": 1e-6},
    "force": {"m/s2": 1.0, "mm/s2": 1e-3, "g": G, "mg": 1e-3 * G, "ug": 1e-6 * G},
    "share": {"": 1.0, "1": 1.0, "-": 1.0},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
}  # fmt: skip
LINEAR: dict[str, dict[str, float]] = {  # of prismatic joints
    "position": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "speed": {"m/s": 1.0, "mm/s": 1e-3},
    "torque": {"n": 1.0, "mn": 1e-3, "kn": 1e3},
    "time": UNITS["time"],
}
SCALED = {  # units that need a figure of the device: its key, and what divides or multiplies it
    "counts": "counts_per_rev",
    "permille": "rated_torque_nm",
    "a": "nm_per_a",
    "ma": "nm_per_a",
}


def plain_unit(unit: str) -> str:
    """Return a unit without spaces, dots of products and capitals: N.m, N m and Nm are nm."""
    short = unit.replace(" ", "").replace("*", "").replace("°", "deg").replace("‰", "permille")
    short = short.replace("²", "2").replace("^2", "2").replace("/s/s", "/s2")
    return short.replace("N.m", "Nm").replace("µ", "u").lower()


class LayoutSignalConfig(Section):
    """One signal of a message: where its bits are, and what they mean."""

    name: Name
    """a signal of the message"""
    start: int = Field(ge=0, le=511)
    """place of its least significant bit (`order: big`: most significant), counted as in a DBC
    file: bit 0 is the least significant one of byte 0"""
    bits: int = Field(ge=1, le=64)
    """its length"""
    order: Literal["little", "big"] = "little"
    """order of its bytes"""
    number: Literal["unsigned", "signed", "float"] = "unsigned"
    """kind of number; a float has 16, 32 or 64 bits"""
    scale: Finite | None = None
    """value = raw x scale + offset; null: 1"""
    offset: Finite | None = None
    """see `scale`; null: 0"""
    range: tuple[Finite, Finite] | None = None
    """in place of both: values of raw 0 and of the largest raw number, as packed formats of motors
    have them"""
    unit: str = ""
    """unit of the value, where the joint does not state it"""
    invalid: int | None = None
    """raw value that stands for no value"""
    multiplexer: str = ""
    """signal that says whether this one is in the frame"""
    pages: tuple[int, ...] = ()
    """values of the multiplexer with which it is"""

    @model_validator(mode="after")
    def _one_scale(self) -> Self:
        if self.range is not None and (self.scale is not None or self.offset is not None):
            raise ValueError("range: given together with scale or offset; must be one of the two")
        if self.range is not None and (self.number != "unsigned" or self.range[0] >= self.range[1]):
            raise ValueError(
                f"range: {list(self.range)} of a {self.number} number; must rise, and be of an "
                "unsigned one"
            )
        if bool(self.multiplexer) != bool(self.pages):
            raise ValueError("pages: go with multiplexer; must both be given, or none of them")
        return self


class LayoutMessageConfig(Section):
    """One kind of frame on a bus."""

    name: Name
    """a message that no file describes; joints refer to it"""
    id: int = Field(ge=0, le=0x1FFFFFFF)
    """its whole identifier"""
    extended: bool = False
    """the identifier has 29 bits"""
    length: int = Field(ge=1, le=64)
    """bytes; shorter frames are rejected"""
    signals: Annotated[tuple[LayoutSignalConfig, ...], Field(min_length=1, max_length=512)]


Role = Literal[
    "position", "speed", "torque",
    "rate_x", "rate_y", "rate_z", "force_x", "force_y", "force_z",
    "q_x", "q_y", "q_z", "q_w",
    "valve", "age", "on_time",
    "time", "counter", "status",
]  # fmt: skip
RATES: tuple[Role, ...] = ("rate_x", "rate_y", "rate_z")
FORCES: tuple[Role, ...] = ("force_x", "force_y", "force_z")
QUATERNION: tuple[Role, ...] = ("q_x", "q_y", "q_z", "q_w")
MEASURES: Mapping[Role, str] = {  # of roles: which of UNITS they have; of others, their own name
    **dict.fromkeys(RATES, "speed"),
    **dict.fromkeys(FORCES, "force"),
    **dict.fromkeys(QUATERNION, "share"),
    **dict.fromkeys(("age", "on_time"), "time"),
}


class SignalConfig(Section):
    """A signal that a device uses, by message and name, and its unit."""

    message: Name
    """`NAME` is a role: `position` or `speed`, `torque`; of an inertial unit `rate_x`, `rate_y`,
    `rate_z`, `force_x`, `force_y`, `force_z`; of a star tracker `q_x`, `q_y`, `q_z`, `q_w`; of a
    thruster `valve`, `age` or `on_time`; of any `time`, `counter`, `status`. Message that holds
    it"""
    signal: Name
    """name of the signal in the message"""
    unit: str | None = None
    """rad, mrad, deg, 0.001 deg, rev, counts; rad/s, deg/s, rev/s, rpm; N m, mN m, permille, A, mA;
    m/s^2, g, mg; s, ms, us, ns; of a prismatic joint m, mm, N; null: as described"""
    counts_per_rev: Positive | None = None
    """for unit `counts`: counts in a turn of the joint"""
    rated_torque_nm: Positive | None = None
    """for unit `permille`: the rated torque at the joint"""
    nm_per_a: Positive | None = None
    """for units `A`, `mA`: torque at the joint per ampere, gear included"""
    invalid: int | None = None
    """raw value that stands for no value"""
    mask: int | None = Field(default=None, ge=1, le=0xFFFFFFFF)
    """for role `status`: bits that are looked at"""
    value: int | None = Field(default=None, ge=0, le=0xFFFFFFFF)
    """for role `status`: what these bits must be; else the sample is rejected"""

    @model_validator(mode="after")
    def _figures(self) -> Self:
        needed = SCALED.get(plain_unit(self.unit or ""))
        for key in dict.fromkeys(SCALED.values()):
            value = getattr(self, key)
            if (key == needed) != (value is not None):
                words = "missing" if key == needed else f"{value:g}; must be left out"
                raise ValueError(f"{key}: {words} with unit {self.unit!r}")
        return self

    @property
    def figure(self) -> float:
        """Return the SI value of one step for the units in `SCALED`."""
        if self.counts_per_rev is not None:
            return tau / self.counts_per_rev
        if self.rated_torque_nm is not None:
            return self.rated_torque_nm * 1e-3
        return (self.nm_per_a or 0.0) * (1e-3 if plain_unit(self.unit or "") == "ma" else 1.0)


class TimingConfig(Section):
    """How a device's samples get their time of validity."""

    by: Literal["echoed_counter", "last_sync", "request", "arrival", "device_time", "time"]
    """what gives a sample its time: the counter of SYNC that it echoes; the SYNC, or `request` of
    another master, that its frame answers; the frame's arrival, by the line under all arrivals; the
    device's own time in the sample; the time of day in the sample, on the clock of TIME (0x100)"""
    requests: Annotated[tuple[Identifier, ...], Field(max_length=16)] = ()
    """by `request`: identifiers of the frames that ask the device; those above 0x7FF have 29 bits
    """
    sigma_s: StampSigma | None = None
    """1 sigma of the error of a sample's time; required by `request`, `arrival`, `device_time` and
    `time`; times the speed of the joint it adds to `position_noise_rad`; null: 0"""
    delay_s: Delay = 0.0
    """from validity to the stamp of SYNC or request, or to sending; by `time`: to the time sent"""
    latest_s: Duration | None = None
    """by `last_sync` and `request`: a frame that comes later is rejected; by `time`:
    an older sample is rejected; null: 0.9 periods, by `time` 1 s"""
    spread_s: Duration | None = None
    """longest time between the frames of one sample; null: half a period; by `last_sync` and
    `request`, frames that answer the same one are one sample, but of a device that skips some"""
    clock_tolerance_ppm: float = Field(default=500.0, gt=0, le=50_000.0)
    """bound of the rate error of the device's timer or clock"""

    @model_validator(mode="after")
    def _needed(self) -> Self:
        if bool(self.requests) != (self.by == "request"):
            words = "missing" if self.by == "request" else "must be left out"
            raise ValueError(f"requests: {words} with timing by {self.by}")
        if self.by not in BY_SYNC and self.sigma_s is None:
            raise ValueError(f"sigma_s: missing; timing by {self.by} needs it")
        return self


class Describable(Protocol):
    """Section of a device whose CAN frames a description may define."""

    @property
    def driver(self) -> str:
        """Name of the driver that reads it."""

    @property
    def bus(self) -> str | None:
        """Name of its bus; None: it is on no bus."""

    @property
    def node_id(self) -> int | None:
        """Its CANopen node number; None: it has none."""

    @property
    def description(self) -> Path | None:
        """EDS or DCF of its node; None: the bus describes its messages."""

    @property
    def kind(self) -> str:
        """Kind of joint whose units it has: `revolute` or `prismatic`."""

    @property
    def signals(self) -> Mapping[Role, SignalConfig] | None:
        """Signals that it sends, by role."""

    @property
    def timing(self) -> TimingConfig | None:
        """How its samples get their times."""


def has_its_keys(own: Describable, keys: Mapping[str, bool | None]) -> None:
    """Raise ValueError for a key that a section's driver needs (True) or refuses (False)."""
    for key, is_needed in keys.items():
        value = getattr(own, key)
        if value is not None and is_needed is False:
            shown = "it" if isinstance(value, dict | Section | Path) else brief(value)
            raise ValueError(f"{key}: {shown} must be left out with driver: {own.driver}")
        if value is None and is_needed:
            raise ValueError(f"{key}: missing with driver: {own.driver}")


def is_described(own: Describable, roles: Collection[Role], words: str) -> bool:
    """Return whether a description defines the frames of a device.

    Parameters
    ----------
    roles : roles of the signals that it needs, besides those of status and time
    words : what needs them, for messages

    Raises
    ------
    ValueError for a key that a described, or another, device must have or must not have.
    """
    found = own.driver == DESCRIBED
    has_its_keys(own, {"signals": found, "timing": found, "description": None if found else False})
    if found:
        has_its_keys(own, {"bus": True, "node_id": True if own.description else None})
    if own.signals is not None and own.timing is not None:
        _roles_given(own.signals, own.timing, roles, words)
    return found


def _roles_given(
    signals: Mapping[Role, SignalConfig], timing: TimingConfig, roles: Collection[Role], words: str
) -> None:
    by: Mapping[str, Role] = {"device_time": "time", "time": "time", "echoed_counter": "counter"}
    needed = [*roles, *(role for how, role in by.items() if how == timing.by)]
    for role in [*needed, *signals]:
        if role not in signals or role not in (*needed, "status"):
            what = "has no use" if role in signals else "missing"
            raise ValueError(f"signals.{role}: {what} with {words}, timing by {timing.by}")
    for role, own in signals.items():
        for key in ("mask", "value"):
            if (getattr(own, key) is not None) != (role == "status"):
                raise ValueError(f"signals.{role}.{key}: only, and always, of status")
