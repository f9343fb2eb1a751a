"""The telecommands of the XTCE, and their packets from arguments given as text."""

import math
import struct
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from spacepackets.ecss.tc import PusTc

from ground.dictionary import XTCE
from ground.errors import UsageError, did_you_mean

_X = "{http://www.omg.org/spec/XTCE/20180204}"
BASE = "pus_telecommand"
HEADER = ("service", "subtype", "source")
ACK_ALL = 0b1111  # acceptance, start, progress, completion
SETTING = "SET_"
PARAMETERS = 20  # service of the parameters
MULTIPLE = "SET_PARAMETERS"
TOGETHER = "set several parameters, all or none: PARAMETER=VALUE, one or more"
INSERT = "INSERT_ACTIVITY"
ON_EVENT = "ADD_EVENT_ACTION"
FRACTIONS_PER_S = 1 << 24
P_FIELD = 0x2F


@dataclass(frozen=True, slots=True, kw_only=True)
class Argument:
    """One argument; kind is integer, float, string, binary or enumerated."""

    name: str
    kind: str
    bits: int
    signed: bool = False
    low: float = -math.inf
    high: float = math.inf
    labels: Mapping[str, int] | None = None
    doc: str = ""

    def encode(self, text: str, *, checked: bool) -> bytes:
        """Return the bytes of a value given as text; `checked`: check limits. Raises UsageError."""
        if self.kind == "binary":
            return self._binary(text)
        if self.kind == "string":
            return self._text(text, checked=checked)
        value = self._number(text)
        if checked:
            self._check(text, value)
        if self.kind == "float":
            return struct.pack(">f" if self.bits == 32 else ">d", value)
        try:
            return int(value).to_bytes(self.bits // 8, "big", signed=self.signed)
        except OverflowError as error:
            raise UsageError(f"{self.name}: {text} does not fit {self.bits} bits") from error

    def _check(self, text: str, value: float) -> None:
        """Raise UsageError unless the dictionary allows the value."""
        if self.labels is not None and value not in self.labels.values():
            raise UsageError(f"{self.name}: {text}; must be one of {', '.join(self.labels)}")
        if not math.isfinite(value):
            raise UsageError(f"{self.name}: {text}; must be a finite number")
        if not self.low <= value <= self.high:
            raise UsageError(f"{self.name}: {text}; must be {self.low:g} to {self.high:g}")

    def _text(self, text: str, *, checked: bool) -> bytes:
        raw, room = text.encode(), self.bits // 8
        if len(raw) > room - checked:  # a zero must end the text
            raise UsageError(f"{self.name}: {len(raw)} bytes; at most {room - checked}")
        if checked and not (text and text.isascii() and text.isprintable()):
            raise UsageError(f"{self.name}: {text!r}; must be printable ASCII, not empty")
        return raw.ljust(room, b"\0")

    def _number(self, text: str) -> float | int:
        if self.labels is not None and text.upper() in self.labels:
            return self.labels[text.upper()]
        try:
            return float(text) if self.kind == "float" else int(text, 0)
        except ValueError as error:
            known = f"one of {', '.join(self.labels)}" if self.labels else "a number"
            raise UsageError(f"{self.name}: {text!r}; must be {known}") from error

    def _binary(self, text: str) -> bytes:
        try:
            if text.startswith("@"):
                return Path(text[1:]).read_bytes()
            return bytes.fromhex(text)
        except (OSError, ValueError) as error:
            raise UsageError(f"{self.name}: {error}; give hex digits or @FILE") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundCommand:
    """One telecommand: fixed bytes and arguments, in their order on the wire."""

    name: str
    doc: str
    apid: int
    service: int
    subtype: int
    entries: tuple[bytes | Argument, ...]
    significance: str = "normal"  # vital or critical: to be confirmed before sending
    warning: str = ""

    @property
    def arguments(self) -> tuple[Argument, ...]:
        """Return the arguments, in their order on the wire."""
        return tuple(entry for entry in self.entries if isinstance(entry, Argument))

    def data(self, given: Mapping[str, str], *, checked: bool = True) -> bytes:
        """Return the application data for arguments given as text. Raises UsageError."""
        known = [argument.name for argument in self.arguments]
        wrong = [name for name in given if name not in known]
        missing = [name for name in known if name not in given]
        if wrong or missing:
            parts = [f"{name}: no such argument" for name in wrong]
            parts += [f"{name}: missing" for name in missing]
            raise UsageError(f"{self.name}: {'; '.join(parts)}")
        return b"".join(
            entry if isinstance(entry, bytes) else entry.encode(given[entry.name], checked=checked)
            for entry in self.entries
        )

    def packet(self, data: bytes, sequence: int) -> bytes:
        """Return the whole packet with its CRC."""
        packet = PusTc(
            service=self.service,
            message_subtype=self.subtype,
            apid=self.apid,
            app_data=data,
            seq_count=sequence,
            ack_flags=ACK_ALL,
        )
        return bytes(packet.pack())


class Catalogue:
    """Every telecommand of the XTCE."""

    def __init__(self, path: Path = XTCE) -> None:
        root = ET.parse(path).getroot().find(f"{_X}CommandMetaData")
        if root is None:
            raise UsageError(f"{path}: has no telecommands")
        types = {item.get("name"): item for item in root.iterfind(f"{_X}ArgumentTypeSet/*")}
        metas = {str(item.get("name")): item for item in root.iterfind(f".//{_X}MetaCommand")}
        apid = int.from_bytes(_fixed(metas.pop(BASE))["packet_id"], "big") & 0x7FF
        self.commands = {name: _command(item, types, apid) for name, item in metas.items()}

    def find(self, name: str) -> GroundCommand:
        """Return a command by name, upper or lower case. Raises UsageError."""
        for known, command in self.commands.items():
            if known.upper() == name.upper():
                return command
        raise UsageError(f"{name}: no such telecommand{did_you_mean(name, self.commands)}")

    def settings(self) -> dict[str, GroundCommand]:
        """Return the commands that set one parameter each, by the parameter's name."""
        return {
            name.removeprefix(SETTING): command
            for name, command in self.commands.items()
            if name.startswith(SETTING) and command.service == PARAMETERS
        }

    def build(
        self, name: str, given: Mapping[str, str], sequence: int, *, checked: bool = True
    ) -> bytes:
        """Return the packet of a command. Raises UsageError."""
        if name.upper() == MULTIPLE:
            return self._set_together(given, sequence, checked=checked)
        command = self.find(name)
        return command.packet(command.data(given, checked=checked), sequence)

    def at(self, packet: bytes, release_s: float, sequence: int) -> bytes:
        """Return the telecommand that schedules a packet for a mission elapsed time [s]."""
        coarse, fine = divmod(round(release_s * FRACTIONS_PER_S), FRACTIONS_PER_S)
        given = {
            "release_p_field": str(P_FIELD),
            "release_coarse_s": str(coarse),
            "release_fine": str(fine),
            "telecommand": packet.hex(),
        }
        return self.build(INSERT, given, sequence)

    def on(self, packet: bytes, event: str, sequence: int) -> bytes:
        """Return the telecommand that makes a packet the action of an event."""
        given = {"apid": str(self.find(ON_EVENT).apid), "event": event, "request": packet.hex()}
        return self.build(ON_EVENT, given, sequence)

    def _set_together(self, given: Mapping[str, str], sequence: int, *, checked: bool) -> bytes:
        """Return one command that sets several parameters, all or none."""
        if not given:
            raise UsageError(f"{MULTIPLE}: give PARAMETER=VALUE, one or more")
        settings = [(self.find(SETTING + name), value) for name, value in given.items()]
        parts = [
            command.data({"value": value}, checked=checked)[1:]  # without the leading count
            for command, value in settings
        ]
        return settings[0][0].packet(bytes((len(parts),)) + b"".join(parts), sequence)


def _command(meta: ET.Element, types: Mapping[str | None, ET.Element], apid: int) -> GroundCommand:
    fixed = _fixed(meta)
    service, subtype, _source = (int.from_bytes(fixed[name], "big") for name in HEADER)
    given = {
        item.get("name"): _argument(item, types[item.get("argumentTypeRef")])
        for item in meta.iterfind(f"{_X}ArgumentList/{_X}Argument")
    }
    entries: list[bytes | Argument] = []
    for entry in meta.iterfind(f"{_X}CommandContainer/{_X}EntryList/*"):
        if entry.get("name") not in HEADER:
            reference = entry.get("argumentRef")
            entries.append(fixed[str(entry.get("name"))] if reference is None else given[reference])
    importance = meta.find(f"{_X}DefaultSignificance")
    level = {} if importance is None else importance.attrib
    return GroundCommand(
        name=str(meta.get("name")),
        doc=meta.get("shortDescription", ""),
        apid=apid,
        service=service,
        subtype=subtype,
        entries=tuple(entries),
        significance=level.get("consequenceLevel", "normal"),
        warning=level.get("reasonForWarning", ""),
    )


def _fixed(meta: ET.Element) -> dict[str, bytes]:
    entries = meta.iterfind(f"{_X}CommandContainer/{_X}EntryList/{_X}FixedValueEntry")
    return {str(e.get("name")): bytes.fromhex(str(e.get("binaryValue"))) for e in entries}


def _argument(item: ET.Element, kind: ET.Element) -> Argument:
    tag = kind.tag.removeprefix(_X).removesuffix("ArgumentType").lower()
    sizes = kind.find(f".//{_X}Fixed/{_X}FixedValue"), kind.find(".//*[@sizeInBits]")
    bits = 0
    if sizes[0] is not None:
        bits = int(sizes[0].text or 0)
    elif sizes[1] is not None:
        bits = int(str(sizes[1].get("sizeInBits")))
    bounds = kind.find(f".//{_X}ValidRange")
    labels = {
        str(e.get("label")).upper(): int(str(e.get("value")))
        for e in kind.iterfind(f".//{_X}Enumeration")
    }
    return Argument(
        name=str(item.get("name")),
        kind=tag,
        bits=bits,
        signed=kind.get("signed") == "true",
        low=_bound(bounds, "minInclusive", -math.inf),
        high=_bound(bounds, "maxInclusive", math.inf),
        labels=labels or None,
        doc=item.get("shortDescription", ""),
    )


def _bound(item: ET.Element | None, name: str, default: float) -> float:
    return default if item is None else float(item.get(name, default))


def given_arguments(words: Sequence[str]) -> dict[str, str]:
    """Return NAME=VALUE words as a mapping. Raises UsageError."""
    found: dict[str, str] = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not equals:
            raise UsageError(f"{word}: must be NAME=VALUE")
        if name in found:
            raise UsageError(f"{name}: given twice")
        found[name] = value
    return found
