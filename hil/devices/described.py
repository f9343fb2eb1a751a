"""Drives whose frames a description gives: DBC and its kin, EDS, DCF, or keys of a configuration.

cantools makes every frame, and canopen reads the mapping of a node. So the flight software, which
reads descriptions in its own way, gets frames that were made without it.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import canopen
import cantools
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion

from hil.devices.dialects import EXTENDED, Frame, Measured, Trigger
from hil.world.sensor_config import DescribedConfig

RESPONSE_NS = 60_000.0  # from SYNC to the first frame ready
REPLY_NS = 180_000.0  # from a request to the first frame ready
GAP_NS = 40_000.0  # between two frames of a drive
FIRST_OBJECT, MOST_STANDARD = 0x0008, 0x7FF  # index, identifier
ROLES = ("position", "speed", "torque", "time", "counter", "status")
COARSE_RAD = 1e-5  # rounding of a slow joint to such a step is no white noise
TRIGGERS: dict[str, Trigger] = {
    "last_sync": "sync",
    "echoed_counter": "sync",
    "request": "command",
    "arrival": "timer",
    "device_time": "timer",
}
UNITS = {  # SI value of one unit, written in lower case without spaces and stops
    "rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "mdeg": math.pi / 180e3,
    "0.001deg": math.pi / 180e3, "0.01deg": math.pi / 18e3,
    "rev": math.tau, "turn": math.tau, "turns": math.tau,
    "rad/s": 1.0, "mrad/s": 1e-3, "deg/s": math.pi / 180, "rev/s": math.tau, "turn/s": math.tau,
    "rpm": math.tau / 60, "rev/min": math.tau / 60,
    "m": 1.0, "mm": 1e-3, "um": 1e-6, "m/s": 1.0, "mm/s": 1e-3,
    "n": 1.0, "mn": 1e-3, "kn": 1e3, "nm": 1.0, "mnm": 1e-3, "unm": 1e-6,
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9,
}  # fmt: skip


class _Field(NamedTuple):
    """A signal of a message that holds a value of a joint."""

    joint: int  # place in the device
    role: str
    message: Message
    signal: Signal
    si: float  # of one unit of the value
    status: int

    def raw(self, own: Measured) -> float:
        """Return the number on the wire."""
        bits, signal = self.signal.length, self.signal
        if self.role == "status":
            return self.status
        if self.role == "counter":
            return own.counter % (1 << bits)
        if self.role == "time":
            return int(own.clock_us * 1e-6 / (abs(signal.scale) * self.si)) % (1 << bits)
        named = {"position": own.position_rad, "speed": own.speed_rad_s, "torque": own.torque_nm}
        raw = (named[self.role] / self.si - signal.offset) / signal.scale
        if signal.is_float:
            return raw
        low = -(1 << bits - 1) if signal.is_signed else 0
        return max(low, min(low + (1 << bits) - 1, round(raw)))

    @property
    def step(self) -> float:
        """Resolution on the wire in SI units; 0: that of a float."""
        return 0.0 if self.signal.is_float else abs(self.signal.scale) * self.si


class _Page(NamedTuple):
    """One frame: a message with certain values of its multiplexers."""

    message: Message
    fields: list[_Field]
    fixed: dict[str, float]  # raw values of the signals that no joint uses


@dataclass(frozen=True, slots=True, kw_only=True)
class DescribedDrive:
    """A device that a description gives."""

    trigger: Trigger
    encode: Callable[..., list[Frame]]  # number of the node, and what each joint measures
    latch_ns: float
    command: Callable[[int], Frame] | None = None


def drives_of(
    nodes: Mapping[int, tuple[int, DescribedConfig]], latch_offset_s: float
) -> dict[tuple[int, ...], DescribedDrive]:
    """Return the devices of a bus by their joints; joints of one message are one device.

    Parameters
    ----------
    nodes : number of the node and description, by joint

    Raises
    ------
    ValueError if a description cannot be read or lacks a signal.
    """
    words = {joint: {word_of(f.message) for f in fields_of(*own)} for joint, own in nodes.items()}
    devices: list[tuple[int, ...]] = []
    for joint, own in words.items():
        sharing = [device for device in devices if any(words[k] & own for k in device)]
        devices = [device for device in devices if device not in sharing]
        devices.append((*(k for device in sharing for k in device), joint))
    return {device: _drive_of([nodes[k] for k in device], latch_offset_s) for device in devices}


def is_node_file(own: DescribedConfig) -> bool:
    """Return whether the description is that of one CANopen node."""
    return own.description is not None and own.description.suffix.lower() in (".eds", ".dcf")


def steps_of(node_id: int, own: DescribedConfig) -> tuple[float, float]:
    """Return the resolution of position [rad] and torque [N m] on the wire, as noise counts it."""
    steps = {field.role: field.step for field in fields_of(node_id, own)}
    position = steps.get("position", 0.0)
    return position * (2.0 if position > COARSE_RAD else 1.0), steps.get("torque", 0.0)


def _drive_of(
    nodes: Sequence[tuple[int, DescribedConfig]], latch_offset_s: float
) -> DescribedDrive:
    fields = [field._replace(joint=k) for k, own in enumerate(nodes) for field in fields_of(*own)]
    pages = list(_pages_of(fields))
    _, first = nodes[0]
    delay_ns = 1e9 * float(first.timing.get("delay_s", 0.0))
    trigger = TRIGGERS[first.timing["by"]]
    after_ns = {"sync": RESPONSE_NS, "command": REPLY_NS, "timer": delay_ns}[trigger]
    asked = [int(word) for word in first.timing.get("requests", ())][:1]

    def encode(_node: int, *measured: Measured) -> list[Frame]:
        frames = []
        for k, page in enumerate(pages):
            raws = page.fixed | {f.signal.name: f.raw(measured[f.joint]) for f in page.fields}
            data = page.message.encode(raws, scaling=False, strict=False)
            word = word_of(page.message)
            frames.append(Frame(after_ns + k * GAP_NS, word, data, is_fd=first.fd))
        return frames

    def ask(_node: int) -> Frame:
        return Frame(0.0, asked[0] | EXTENDED * (asked[0] > MOST_STANDARD), bytes(8))

    return DescribedDrive(
        trigger=trigger,
        encode=encode,
        latch_ns=0.0 if trigger == "timer" else latch_offset_s * 1e9 - delay_ns,
        command=ask if trigger == "command" else None,
    )


def word_of(message: Message) -> int:
    """Return the identifier of a message, with the flag of 29 bits."""
    return message.frame_id | EXTENDED * message.is_extended_frame


def fields_of(node_id: int, own: DescribedConfig) -> list[_Field]:
    """Return the signals of a joint; that of the position, which carries the time, is the first.

    Raises
    ------
    ValueError if the description lacks a message, a signal or a unit.
    """
    messages = _messages_of(node_id, own)
    fields = []
    for role in ROLES:
        use = own.signals.get(role)
        if use is None:
            continue
        message = messages.get(use["message"])
        signals = {} if message is None else {s.name: s for s in message.signals}
        if message is None or use["signal"] not in signals:
            raise ValueError(f"{use['message']}.{use['signal']}: not in the description")
        signal = signals[use["signal"]]
        fields.append(_Field(0, role, message, signal, _si(use, signal), int(use.get("value", 0))))
    return fields


def _si(use: Mapping[str, Any], signal: Signal) -> float:
    """Return the SI value of one unit of a signal's value."""
    if "counts_per_rev" in use:
        return math.tau / float(use["counts_per_rev"])
    if "rated_torque_nm" in use:
        return float(use["rated_torque_nm"]) / 1000.0
    unit = str(use.get("unit") or signal.unit or "").lower().replace("°", "deg").replace("µ", "u")
    short = "".join(unit.split()).replace("*", "").replace("n.m", "nm")
    if "nm_per_a" in use:
        return float(use["nm_per_a"]) * (1e-3 if short == "ma" else 1.0)
    if "mask" in use or not short:
        return 1.0
    if short not in UNITS:
        raise ValueError(f"{use['message']}.{use['signal']}: unit {unit!r} is not known")
    return UNITS[short]


def _pages_of(fields: Sequence[_Field]) -> Iterator[_Page]:
    """Yield the frames of a device: each message once, or once for every page that is used."""
    for message in {word_of(field.message): field.message for field in fields}.values():
        own = [field for field in fields if word_of(field.message) == word_of(message)]
        chosen = [_selected(message, field.signal) for field in own]
        for page in [one for one in _unique(chosen) if not _is_part(one, chosen)]:
            defaults = dict[str, float]()
            for signal in message.signals:
                defaults.setdefault(signal.name, 0)
                if signal.multiplexer_signal and signal.multiplexer_ids:
                    defaults[signal.multiplexer_signal] = signal.multiplexer_ids[0]
            pairs = zip(own, chosen, strict=True)
            inside = [field for field, needs in pairs if needs.items() <= page.items()]
            yield _Page(message, inside, defaults | page)


def _unique(pages: Sequence[dict[str, float]]) -> list[dict[str, float]]:
    return [page for k, page in enumerate(pages) if page not in pages[:k]]


def _is_part(page: dict[str, float], pages: Sequence[dict[str, float]]) -> bool:
    """Return whether another page has the values of this one and more."""
    return any(page.items() < other.items() for other in pages)


def _selected(message: Message, signal: Signal) -> dict[str, float]:
    """Return the raw values of multiplexers with which a signal is in its frame."""
    by_name, found = {own.name: own for own in message.signals}, dict[str, float]()
    while signal.multiplexer_signal is not None and signal.multiplexer_ids:
        found[signal.multiplexer_signal] = signal.multiplexer_ids[0]
        signal = by_name[signal.multiplexer_signal]
    return found


def _messages_of(node_id: int, own: DescribedConfig) -> dict[str, Message]:
    """Return the messages of the file of a joint and of its keys."""
    found = {keys["name"]: _message_of_keys(keys) for keys in own.messages}
    if own.description is None:
        return found
    path = own.description
    try:
        of_file = _node_file(path, node_id) if is_node_file(own) else _bus_file(path)
    except Exception as error:  # the libraries raise whatever comes up
        words = " ".join(str(error).split())
        raise ValueError(f"{path}: cannot be read: {words}") from error
    return of_file | found


@lru_cache(maxsize=64)
def _bus_file(path: Path) -> dict[str, Message]:
    database = cantools.database.load_file(path, strict=False)
    if not isinstance(database, cantools.database.can.Database):
        raise ValueError("describes no message")
    return {message.name: message for message in database.messages}


@lru_cache(maxsize=256)
def _node_file(path: Path, node_id: int) -> dict[str, Message]:
    """Return the transmit PDOs of a node, `TPDO1` and so on, as canopen reads them."""
    node = canopen.RemoteNode(node_id, str(path))
    canopen.Network().add_node(node)
    node.tpdo.read(from_od=True)  # type: ignore[no-untyped-call]
    return {
        f"TPDO{number}": _message_of_pdo(f"TPDO{number}", pdo)
        for number, pdo in (node.tpdo.map or {}).items()
        if pdo.enabled and pdo.map and pdo.cob_id
    }


def _message_of_pdo(name: str, pdo: canopen.pdo.PdoMap) -> Message:
    signals, identifier = [], int(pdo.cob_id or 0)
    for entry in pdo.map:
        if entry.index >= FIRST_OBJECT:
            sub, kind = f":{entry.subindex:02x}" if entry.subindex else "", entry.od.data_type
            signals.append(
                Signal(
                    f"0x{entry.index:04x}{sub}",
                    entry.offset or 0,
                    entry.length,
                    is_signed=kind in canopen.objectdictionary.SIGNED_TYPES,
                    unit=entry.od.unit,
                    conversion=BaseConversion.factory(
                        scale=entry.od.factor,
                        is_float=kind in canopen.objectdictionary.FLOAT_TYPES,
                    ),
                )
            )
    bits = sum(entry.length for entry in pdo.map)
    return Message(
        frame_id=identifier,
        name=name,
        length=(bits + 7) // 8,
        signals=signals,
        is_extended_frame=identifier > MOST_STANDARD,
        strict=False,
    )


def _message_of_keys(keys: Mapping[str, Any]) -> Message:
    """Return a message that the keys of a configuration describe."""
    signals = []
    selectors = {own["multiplexer"] for own in keys["signals"] if own.get("multiplexer")}
    for own in keys["signals"]:
        scale, offset = own.get("scale") or 1, own.get("offset") or 0
        if own.get("range"):
            low, high = own["range"]
            scale, offset = (high - low) / (2 ** own["bits"] - 1), low
        signals.append(
            Signal(
                own["name"],
                own["start"],
                own["bits"],
                conversion=BaseConversion.factory(
                    scale=scale, offset=offset, is_float=own.get("number") == "float"
                ),
                unit=own.get("unit"),
                is_signed=own.get("number") == "signed",
                byte_order="big_endian" if own.get("order") == "big" else "little_endian",
                is_multiplexer=own["name"] in selectors,
                multiplexer_signal=own.get("multiplexer") or None,
                multiplexer_ids=list(own.get("pages") or ()) or None,
            )
        )
    return Message(
        frame_id=keys["id"],
        name=keys["name"],
        length=keys["length"],
        signals=signals,
        is_extended_frame=bool(keys.get("extended")),
        strict=False,
    )
