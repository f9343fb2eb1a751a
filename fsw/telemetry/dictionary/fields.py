"""Functions that make the fields of packets: numbers, labels, texts, counters."""

from fsw.telemetry.dictionary.codes import ERROR
from fsw.telemetry.dictionary.types import Concern, Enumeration, Field, Limits, Type

YELLOW, RED = Concern.YELLOW, Concern.RED
ZERO = Limits(yellow_high=0)  # for values that count or mark faults


def number(
    name: str, kind: Type, unit: str = "", doc: str = "", limits: Limits | None = None
) -> Field:
    """Return a plain numeric field."""
    return Field(name=name, type=kind, unit=unit, doc=doc, limits=limits)


def choice(name: str, enumeration: Enumeration, doc: str = "", **concerns: Concern) -> Field:
    """Return an enumerated field of one byte; `concerns` names labels that need attention."""
    return Field(
        name=name, type=Type.U8, enumeration=enumeration, doc=doc, alarms=tuple(concerns.items())
    )


def error(name: str, doc: str = "") -> Field:
    """Return a field with an error code; every error is yellow."""
    alarms = tuple((label, YELLOW) for number, label in ERROR.labels.items() if number)
    return Field(name=name, type=Type.U16, enumeration=ERROR, doc=doc, alarms=alarms)


def text(name: str, size: int, doc: str = "") -> Field:
    """Return a text field of fixed size."""
    return Field(name=name, type=Type.TEXT, size=size, doc=doc)


def counters(*names: str, limits: Limits | None = None) -> tuple[Field, ...]:
    """Return one 32-bit counter field per name."""
    return tuple(number(name, Type.U32, limits=limits) for name in names)
