"""Which signals of which messages a device uses: configuration meets descriptions."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import NamedTuple

from fsw.config import BusConfig, BusDevice, Config, Describable, JointConfig
from fsw.config.actuators import ON_BUS
from fsw.config.joints import TORQUE_STEP_NM
from fsw.config.signals import (
    DESCRIBED,
    FORCES,
    LINEAR,
    MEASURES,
    QUATERNION,
    RATES,
    SCALED,
    UNITS,
    LayoutSignalConfig,
    Role,
    SignalConfig,
    TimingConfig,
    plain_unit,
)
from fsw.drivers.layout.files import read_messages, read_node
from fsw.drivers.layout.signals import Message, Signal, chain, faults
from fsw.errors import ConfigError, brief

TIME, COUNTER, STATUS, FIRST = range(4)  # places of roles in an array; the values come last
POSITION, TORQUE = FIRST, FIRST + 1  # a speed is in place of a position
VALVE, CHANGE = FIRST, FIRST + 1  # the change: its age, or for how long the valve has been open
ROLES_BY_NAME: dict[Role, int] = {
    "position": POSITION,
    "speed": POSITION,
    "torque": TORQUE,
    **{role: FIRST + k for k, role in enumerate((*RATES, *FORCES))},
    **{role: FIRST + k for k, role in enumerate(QUATERNION)},
    "valve": VALVE,
    "age": CHANGE,
    "on_time": CHANGE,
    "time": TIME,
    "counter": COUNTER,
    "status": STATUS,
}
RAW: tuple[Role, ...] = ("counter", "status", "valve")  # bits without scale
CLOCKS: tuple[Role, ...] = ("time", "on_time")  # that wrap
MOST_CLOCK_BITS = 48  # of device time: an exact number, and longer than any silence
FLOAT_STEPS = 2**11  # least steps of a converter behind a float, from zero to the torque's limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Use:
    """One signal that a device uses; its value in SI is the decoded one times `factor`."""

    role: int
    message: Message
    signal: Signal
    factor: float


class Part(NamedTuple):
    """One kind of frame of a device's sample: a message, or one page of its multiplexer."""

    message: Message
    uses: tuple[Use, ...]
    page: Signal | None  # NaN in frames of other pages; None: it is in every frame of the message


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """What one device sends: signals by role, how they are timed, which status is good."""

    uses: tuple[Use, ...]
    timing: TimingConfig
    mask: int = 0  # bits of the status that are checked
    value: int = 0  # value that they must have

    def use(self, role: int) -> Use | None:
        """Return the signal of a role; None: the device has none."""
        return next((use for use in self.uses if use.role == role), None)

    @property
    def messages(self) -> tuple[Message, ...]:
        """Messages of which a sample consists, each once.

        The first has the position, and its time counts as that of the sample.
        """
        return tuple({use.message.word: use.message for use in self.uses}.values())

    @property
    def parts(self) -> tuple[Part, ...]:
        """Kinds of frames of which a sample consists; the time of the first is the sample's."""
        return tuple(part for own in self.messages for part in _parts_of(own, self.uses))


def _parts_of(message: Message, uses: Sequence[Use]) -> Iterator[Part]:
    """Yield the message, or those of its pages that hold values, that of the first value first.

    What is in each of its frames besides, such as a status, counts in the first page.
    """
    own = tuple(use for use in uses if use.message.word == message.word)
    pages = dict[frozenset[tuple[str, frozenset[int]]], list[Use]]()
    for use in own:
        needs = frozenset((by.name, values) for by, values in chain(message, use.signal))
        pages.setdefault(needs, []).append(use)
    common = pages.pop(frozenset(), [])
    if not pages or any(use.role >= FIRST for use in common):
        yield Part(message, own, None)
        return
    for needs in list(pages):
        if (more := next((other for other in pages if needs < other), None)) is not None:
            pages[more] = [*pages[more], *pages.pop(needs)]
    for group in sorted(pages.values(), key=lambda group: min(map(own.index, group))):
        yield Part(message, (*common, *group), replace(_raw(group[0].signal), invalid=None))
        common = []


def layouts_of(config: Config, bus: BusConfig, section: str = "joints") -> dict[int, Layout]:
    """Return the layouts of the described devices of one section on one bus.

    The keys are the devices' indices in `section`; 0 for a section of one device.

    Raises
    ------
    ConfigError with one line per fault.
    """
    found = all_layouts(config, bus, (section,))
    return {int(at.partition(".")[2] or 0): layout for at, layout in found.items()}


def all_layouts(
    config: Config, bus: BusConfig, sections: Sequence[str] = ON_BUS
) -> dict[str, Layout]:
    """Return the layouts of the described devices of one bus by the places of the devices.

    Raises
    ------
    ConfigError with one line per fault.
    """
    places = {
        at: own
        for at, own in config.bus_devices.items()
        if (own.bus, own.driver) == (bus.name, DESCRIBED) and at.partition(".")[0] in sections
    }
    if not places:
        return {}
    shared, lines, found = _messages_of(config, bus), list[str](), dict[str, Layout]()
    for at, device in places.items():
        messages = shared
        if device.description and device.node_id is not None:
            messages = read_node(config.resolve(device.description), device.node_id)
        try:
            found[at] = _layout_of(device, messages)
        except ConfigError as error:
            lines += [f"{at}.{line}" for line in str(error).splitlines()]
    if lines:
        raise ConfigError("\n".join(lines))
    return found


def in_words(device: BusDevice, layout: Layout) -> str:
    """Return what a device reads, with the SI value of a step of each number, and its timing."""
    read = "; ".join(
        f"{name} {use.message.name}.{use.signal.name} (0x{use.message.identifier:x}) "
        f"{use.signal.bits} bits {use.signal.number}, step {abs(use.signal.scale * use.factor):.4g}"
        for name in device.signals or {}
        if (use := layout.use(ROLES_BY_NAME[name])) is not None
    )
    timing = layout.timing
    return f"{device.name}: {read}; time by {timing.by}, sigma {timing.sigma_s or 0.0:g} s"


def torque_steps_nm(config: Config) -> list[float]:
    """Return the resolution of every joint's torque on the wire [N m]."""
    layouts = {i: own for bus in config.buses for i, own in layouts_of(config, bus).items()}
    return [
        _torque_step_nm(joint, layouts.get(i)) if i in layouts else TORQUE_STEP_NM[joint.format]
        for i, joint in enumerate(config.joints)
    ]


def _torque_step_nm(joint: JointConfig, layout: Layout | None) -> float:
    use = None if layout is None else layout.use(TORQUE)
    if use is None or use.signal.number == "float":
        return joint.torque_limit_nm / FLOAT_STEPS
    return abs(use.signal.scale * use.factor)


def position_step_rad(joint: JointConfig, layout: Layout) -> float:
    """Return the resolution of a joint's encoder; for a float, that of equal noise [rad or m]."""
    use = layout.use(POSITION)
    if use is None or use.signal.number == "float":
        return joint.position_noise_rad * sqrt(12.0)
    return abs(use.signal.scale * use.factor)


def _messages_of(config: Config, bus: BusConfig) -> dict[str, Message]:
    """Return the messages of a bus's file and of its own keys."""
    found: dict[str, Message] = {}
    if bus.description is not None:
        found |= read_messages(config.resolve(bus.description))
    for own in bus.messages:
        if own.name in found:
            raise ConfigError(f"buses.{bus.name}.messages: {own.name!r} is there twice")
        found[own.name] = Message(
            name=own.name,
            identifier=own.id,
            is_extended=own.extended,
            length=own.length,
            signals=tuple(_signal_of(signal) for signal in own.signals),
        )
    return found


def _signal_of(own: LayoutSignalConfig) -> Signal:
    scale = 1 if own.scale is None else own.scale
    offset = own.offset or 0
    if own.range is not None:
        low, high = own.range
        scale, offset = (high - low) / ((1 << own.bits) - 1), low
    return Signal(
        name=own.name,
        start=own.start,
        bits=own.bits,
        big_endian=own.order == "big",
        number=own.number,
        scale=scale,
        offset=offset,
        unit=own.unit,
        invalid=own.invalid,
        selector=own.multiplexer,
        pages=frozenset(own.pages),
    )


def _layout_of(device: Describable, messages: Mapping[str, Message]) -> Layout:
    uses, lines = [], []
    for name, role in ROLES_BY_NAME.items():
        own = (device.signals or {}).get(name)
        if own is None:
            continue
        try:
            uses.append(_use(device, name, role, own, messages))
        except ConfigError as error:
            lines.append(f"{name}.{error}")
    lines = [f"signals.{line}" for line in lines or _status_faults(uses)]
    timing, status = device.timing, (device.signals or {}).get("status")
    lines += ["timing: missing"] if timing is None else _time_faults(timing, uses)
    if lines or timing is None:
        raise ConfigError("\n".join(lines))
    mask, value = (status and status.mask) or 0, (status and status.value) or 0
    return Layout(uses=tuple(uses), timing=timing, mask=mask, value=value)


def _use(
    device: Describable, name: Role, role: int, own: SignalConfig, messages: Mapping[str, Message]
) -> Use:
    message = messages.get(own.message)
    if message is None:
        raise ConfigError(f"message: {own.message!r} is not described; {_some(messages)} are")
    for fault in faults(message):
        raise ConfigError(f"message: {fault}")
    signal = message.signal(own.signal)
    if signal is None:
        has = _some({each.name: each for each in message.signals})
        raise ConfigError(f"signal: {own.signal!r} is not in {message.name}; {has} are")
    if own.invalid is not None:
        signal = replace(signal, invalid=own.invalid)
    if name in (*RAW, *CLOCKS) and signal.number == "float":
        raise ConfigError(f"signal: {own.signal!r} is a float; must be an integer")
    if name in RAW:
        return Use(role=role, message=message, signal=_raw(signal), factor=1.0)
    factor = _factor(device, name, own, signal)
    if name in CLOCKS:
        step_s = abs(signal.scale) * factor
        return Use(role=role, message=message, signal=_clock(_raw(signal)), factor=step_s)
    return Use(role=role, message=message, signal=signal, factor=factor)


def _raw(signal: Signal) -> Signal:
    return replace(signal, scale=1, offset=0, number="unsigned")


def _clock(signal: Signal) -> Signal:
    """Return the low bits of a device's time."""
    spare = max(0, signal.bits - MOST_CLOCK_BITS)
    if spare and signal.big_endian:
        place = signal.places()[spare]
        return replace(signal, start=place // 8 * 8 + 7 - place % 8, bits=MOST_CLOCK_BITS)
    return replace(signal, bits=signal.bits - spare)


def _factor(device: Describable, name: Role, own: SignalConfig, signal: Signal) -> float:
    """Return the SI value of a signal's unit, which must not contradict the description."""
    unit, described = plain_unit(own.unit or signal.unit), plain_unit(signal.unit)
    table = (UNITS if device.kind == "revolute" else LINEAR)[MEASURES.get(name, name)]
    if described in table and table.get(unit) != table[described]:
        raise ConfigError(
            f"unit: {own.unit!r}, but the description says {signal.unit!r} of the value after its "
            "scale; leave unit out, or mend the description"
        )
    scaled = {"position": ("counts",), "torque": ("permille", "a", "ma")}.get(name, ())
    if unit in SCALED and unit in scaled:
        if not own.figure:
            raise ConfigError(f"{SCALED[unit]}: missing; the description says {signal.unit!r}")
        return own.figure
    if unit not in table:
        known = ", ".join(filter(None, [*table, *scaled]))
        raise ConfigError(f"unit: {own.unit or signal.unit!r} is not known; must be one of {known}")
    return table[unit]


def _status_faults(uses: list[Use]) -> Iterator[str]:
    """Yield a line if status has a message of its own, which might come at another rate."""
    others = {use.message.word for use in uses if use.role != STATUS}
    for use in uses:
        if use.role == STATUS and use.message.word not in others:
            yield f"status.message: {use.message.name!r} holds no other signal of the device"


def _time_faults(timing: TimingConfig, uses: list[Use]) -> Iterator[str]:
    """Yield a line if the step of a time of day is coarser than the stated error."""
    step_s = max((u.factor for u in uses if u.role == TIME), default=0.0)
    if timing.by == "time" and (timing.sigma_s or 0.0) < 0.28 * step_s:
        yield (
            f"timing.sigma_s: {timing.sigma_s:g}; must be at least {0.28 * step_s:g}, as the time "
            f"in a sample counts steps of {step_s:g} s"
        )


def _some(names: Mapping[str, object]) -> str:
    listed = ", ".join(list(names)[:8])
    return brief(listed) if len(names) <= 8 else f"{listed} ..."
