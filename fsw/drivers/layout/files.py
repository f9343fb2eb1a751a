"""Reads descriptions of others: DBC, KCD, SYM and ARXML by cantools, EDS and DCF by canopen.

The libraries read descriptions only; no frame passes through them. A file may be anything, so its
size and the number of its messages are bounded before a library sees it.
"""

import io
import logging
import re
from collections.abc import Callable, Collection, Mapping, Sized
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from fsw.drivers.layout.signals import Message, Number, Signal
from fsw.drivers.wire import PdoMapping
from fsw.errors import ConfigError

if TYPE_CHECKING:
    from canopen.objectdictionary import ObjectDictionary, ODVariable
    from cantools.database.can import Message as LibraryMessage
    from cantools.database.can import Signal as LibrarySignal

MOST_BYTES = 4_000_000
MOST_MESSAGES = 5_000  # also of the entries of an EDS
SUFFIXES = (".dbc", ".kcd", ".sym", ".arxml")
NODE_SUFFIXES = (".eds", ".dcf")
_HEADS = {  # what begins a message in a file of each kind
    ".dbc": rb"^\s*BO_\s",
    ".kcd": rb"<\s*Message\s",
    ".sym": rb"^\s*\[",
    ".arxml": rb"<CAN-FRAME-TRIGGERING",
    ".eds": rb"^\s*\[",
    ".dcf": rb"^\s*\[",
}
_TYPES: dict[int, Number] = {  # CiA 301 data types that are numbers
    **dict.fromkeys((0x01, 0x05, 0x06, 0x07, 0x16, 0x18, 0x19, 0x1A, 0x1B), "unsigned"),
    **dict.fromkeys((0x02, 0x03, 0x04, 0x10, 0x12, 0x13, 0x14, 0x15), "signed"),
    **dict.fromkeys((0x08, 0x11), "float"),
}
DUMMIES = range(1, 8)  # indexes of entries that only fill a gap
VALID, EXTENDED = 1 << 31, 1 << 29  # bits of a COB-ID entry; the first means: does not exist
MULTIPLEXED = (254, 255)  # number of mapped objects of a multiplexed PDO
_Found = TypeVar("_Found", bound=Sized)

for _library in ("canopen", "cantools"):  # what they log is not this program's
    logging.getLogger(_library).addHandler(logging.NullHandler())


def read_messages(path: Path) -> dict[str, Message]:
    """Return the messages of a DBC, KCD, SYM or ARXML file by name.

    Raises
    ------
    ConfigError in one line when the file cannot be used.
    """
    text = _text(path, SUFFIXES)

    def read() -> dict[str, Message]:
        from cantools.database import load_string
        from cantools.database.can import Database

        found = load_string(text, path.suffix.lower().removeprefix("."), strict=False)
        messages = found.messages if isinstance(found, Database) else []
        return {own.name: _message_of(own) for own in messages}

    return _guarded(path, read)


def read_node(
    path: Path, node_id: int, written: Mapping[tuple[int, int], int] | None = None
) -> dict[str, Message]:
    """Return the transmit PDOs of an EDS or DCF as messages `TPDO1`, `TPDO2` ...

    A signal has the name of its object, such as `0x6064` or `0x2012:03`. Identifier, mapping and
    `Factor` are those of the file; a PDO that does not exist is left out.

    Parameters
    ----------
    written : values that a master writes, by index and subindex; mapping entries without their
        number of bits

    Raises
    ------
    ConfigError in one line when the file cannot be used.
    """
    text = _text(path, NODE_SUFFIXES)

    def read() -> dict[str, Message]:
        objects = _objects(text, path, node_id)
        for (index, sub), value in (written or {}).items():
            _variable(objects, index, sub).value = _whole_entry(objects, index, sub, value)
        names = {0x1A00 + k: f"TPDO{k + 1}" for k in range(512) if 0x1A00 + k in objects}
        found = {name: _pdo(name, objects, index) for index, name in names.items()}
        return {name: message for name, message in found.items() if message is not None}

    return _guarded(path, read)


def read_mappings(path: Path, node_id: int, names: Collection[str]) -> list[PdoMapping]:
    """Return the named transmit PDOs of an EDS or DCF as a master writes them.

    Raises
    ------
    ConfigError in one line when the file cannot be used.
    """
    text = _text(path, NODE_SUFFIXES)

    def read() -> list[PdoMapping]:
        objects = _objects(text, path, node_id)
        numbers = sorted(int(name.removeprefix("TPDO")) for name in names)
        return [_mapping(objects, number) for number in numbers]

    return _guarded(path, read)


def _objects(text: str, path: Path, node_id: int) -> "ObjectDictionary":
    from canopen.objectdictionary import import_od

    own = io.StringIO(text)
    own.name = str(path)  # the library takes the kind of file from it
    return import_od(own, node_id)


def _mapping(objects: "ObjectDictionary", number: int) -> PdoMapping:
    communication, mapping = 0x1800 + number - 1, 0x1A00 + number - 1
    further = {
        key: _value(objects, communication, sub)
        for key, sub in (("inhibit", 3), ("event_ms", 5))
        if objects.get_variable(communication, sub) is not None
    }
    count = _value(objects, mapping, 0)
    return PdoMapping(
        number=number,
        cob_id=_value(objects, communication, 1),
        transmission=_value(objects, communication, 2),
        entries=tuple(_value(objects, mapping, k) for k in range(1, count + 1)),
        **further,
    )


def _text(path: Path, suffixes: tuple[str, ...]) -> str:
    """Return the text of a description whose size is bounded."""
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        raise ConfigError(f"{path}: ends in {suffix!r}; must end in {', '.join(suffixes)}")
    if not path.is_file():
        raise ConfigError(f"{path}: is not a file")
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    if len(data) > MOST_BYTES:
        raise ConfigError(f"{path}: is larger than {MOST_BYTES} bytes")
    if b"\0" in data:
        raise ConfigError(f"{path}: is binary, not a description in text")
    count = len(re.findall(_HEADS[suffix], data, re.MULTILINE))
    if count > MOST_MESSAGES:
        raise ConfigError(f"{path}: has {count} messages or entries; at most {MOST_MESSAGES}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")  # what editors of DBC files write


def _guarded(path: Path, read: Callable[[], _Found]) -> _Found:
    """Return what a library reads; any error of it is a fault of the file."""
    try:
        found = read()
    except ImportError as error:
        raise ConfigError(f"{path}: needs the package {error.name}") from error
    except (Exception, RecursionError) as error:  # parsers raise whatever comes up
        raise ConfigError(
            f"{path}: cannot be read: {' '.join(str(error).split())[:200]}"
        ) from error
    if not found:
        raise ConfigError(f"{path}: describes no message")
    return found


def _message_of(own: "LibraryMessage") -> Message:
    """Return a message of cantools."""
    return Message(
        name=own.name,
        identifier=own.frame_id,
        is_extended=own.is_extended_frame,
        length=own.length,
        signals=tuple(_signal_of(signal) for signal in own.signals),
    )


def _signal_of(own: "LibrarySignal") -> Signal:
    number: Number = "float" if own.is_float else "signed" if own.is_signed else "unsigned"
    return Signal(
        name=own.name,
        start=own.start,
        bits=own.length,
        big_endian=own.byte_order == "big_endian",
        number=number,
        scale=own.scale,
        offset=own.offset,
        unit=own.unit or "",
        selector=own.multiplexer_signal or "",
        pages=frozenset(own.multiplexer_ids or ()),
    )


def _pdo(name: str, objects: "ObjectDictionary", index: int) -> Message | None:
    """Return the PDO mapped by an object; None: it does not exist or maps nothing."""
    word, count = _value(objects, index - 0x200, 1), _value(objects, index, 0)
    if word & VALID or count in (0, *MULTIPLEXED):
        return None
    signals, at = [], 0
    for k in range(1, count + 1):
        entry = _value(objects, index, k)
        place, sub, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        if place not in DUMMIES:
            own = _variable(objects, place, sub)
            signals.append(
                Signal(
                    name=f"0x{place:04x}" + (f":{sub:02x}" if sub else ""),
                    start=at,
                    bits=bits,
                    number=_TYPES.get(own.data_type or 0, "unsigned"),
                    scale=own.factor,
                    unit=own.unit or "",
                    title=own.name.rpartition(".")[2],
                )
            )
        at += bits
    is_extended = bool(word & EXTENDED)
    return Message(
        name=name,
        identifier=word & (0x1FFFFFFF if is_extended else 0x7FF),
        is_extended=is_extended,
        length=(at + 7) // 8,
        signals=tuple(signals),
    )


def _whole_entry(objects: "ObjectDictionary", index: int, sub: int, value: int) -> int:
    """Return a written value; an entry of a mapping gets the number of bits of its object."""
    if not (sub and 0x1A00 <= index < 0x1C00):
        return value
    return value | len(_variable(objects, value >> 16, value >> 8 & 0xFF))


def _variable(objects: "ObjectDictionary", index: int, sub: int) -> "ODVariable":
    found = objects.get_variable(index, sub)
    if found is None:
        raise ValueError(f"object 0x{index:04x}:{sub:02x} is mapped and does not exist")
    return found


def _value(objects: "ObjectDictionary", index: int, sub: int) -> int:
    """Return what a DCF writes into an object, else its default."""
    own = _variable(objects, index, sub)
    return int((own.value if own.value is not None else own.default) or 0)
