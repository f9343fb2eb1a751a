"""Values that the page can plot: all numbers of the dictionary, and 1 sigma bands of estimates."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from space_packet_parser import XtcePacketDefinition, load_xtce
from space_packet_parser.xtce.parameter_types import (
    EnumeratedParameterType,
    StringParameterType,
)

from ground.dictionary import XTCE
from ground.telemetry import CRC, HEADER, SHARED, Sample, Value

SIGMA = "sigma"
EVENTS = "events"
BODIES, PRESENT = ("base", "target"), "_present"
EVENT_SERVICE = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class TelemetryPoint:
    """One telemetry value that the page can plot over time."""

    key: str  # packet.field
    packet: str
    field: str
    unit: str
    doc: str
    labels: Mapping[int, str] | None = None


class Points:
    """All points of the dictionary."""

    def __init__(self, path: Path = XTCE) -> None:
        definition = load_xtce(path)
        self.packets: dict[str, tuple[TelemetryPoint, ...]] = {}
        self._numbers: dict[str, dict[str, int]] = {}
        for name, container in definition.containers.items():
            if not container.abstract and not name.startswith("event_"):
                found = tuple(self._of(definition, name))
                self.packets[name] = (*found, *_bands(found))
        self.by_key = {p.key: p for points in self.packets.values() for p in points}

    def numbers(self, sample: Sample) -> dict[str, float]:
        """Return the numbers of a packet by field, with labels as numbers and 1 sigma bounds."""
        numbers = {
            name: float(value) if not isinstance(value, str) else self._numbers[name_of][value]
            for name, value, name_of in self._numeric(sample)
        }
        for body in BODIES:
            if numbers.get(f"{body}{PRESENT}") == 0.0:  # a body not identified must not show 0 kg
                numbers = {k: v for k, v in numbers.items() if not _is_value_of(k, body)}
        for field, (value, sigma) in _pairs(numbers):
            numbers[f"{field}_low"] = value - sigma
            numbers[f"{field}_high"] = value + sigma
        return numbers

    def _numeric(self, sample: Sample) -> Iterator[tuple[str, Value, str]]:
        for name, value in sample.values.items():
            key = f"{sample.packet}.{name}"
            if not isinstance(value, str) or value in self._numbers.get(key, {}):
                yield name, value, key

    def _of(self, definition: XtcePacketDefinition, name: str) -> Iterator[TelemetryPoint]:
        for entry in definition.containers[name].entry_list:
            kind = entry.parameter_type
            if entry.name.startswith((HEADER, SHARED)) or entry.name == CRC:
                continue
            if isinstance(kind, StringParameterType):
                continue
            field = entry.name.removeprefix(f"{name}_")
            labels = None
            if isinstance(kind, EnumeratedParameterType):
                labels = {int(number): str(label) for number, label in kind.enumeration.items()}
                self._numbers[f"{name}.{field}"] = {v: k for k, v in labels.items()}
            yield TelemetryPoint(
                key=f"{name}.{field}",
                packet=name,
                field=field,
                unit=kind.unit or "",
                doc=entry.short_description or "",
                labels=labels,
            )


def _bands(points: tuple[TelemetryPoint, ...]) -> Iterator[TelemetryPoint]:
    """Yield the lower and upper bound of every point that has a sigma."""
    fields = {point.field: point for point in points}
    for point in points:
        if _sigma_of(point.field) not in fields:
            continue
        for side, words in (("low", "less"), ("high", "plus")):
            yield TelemetryPoint(
                key=f"{point.key}_{side}",
                packet=point.packet,
                field=f"{point.field}_{side}",
                unit=point.unit,
                doc=f"{point.doc}: {words} 1 sigma",
            )


def _pairs(numbers: Mapping[str, float]) -> list[tuple[str, tuple[float, float]]]:
    return [
        (field, (value, numbers[sigma]))
        for field, value in numbers.items()
        if (sigma := _sigma_of(field)) in numbers
    ]


def _is_value_of(field: str, body: str) -> bool:
    return field.startswith(f"{body}_") and not field.endswith(PRESENT)


def _sigma_of(field: str) -> str:
    """Return the name of the sigma of field BODY_REST: BODY_sigma_REST."""
    body, _, rest = field.partition("_")
    return f"{body}_{SIGMA}_{rest}"


def event_of(sample: Sample) -> dict[str, str] | None:
    """Return an event's severity, code and text; None for any other packet."""
    if sample.service != EVENT_SERVICE or "event" not in sample.values:
        return None
    return {
        "severity": sample.packet.removeprefix("event_"),
        "code": str(sample.values["event"]),
        "text": str(sample.values["text"]).rstrip("\0"),
    }


def health_bits(points: Points) -> dict[int, tuple[str, str]]:
    """Return severity and name of the health word's bits by number, read from its description."""
    words = points.by_key["health.health"].doc.partition("bits: ")[2]
    parts = (item.split(" ", 2) for item in words.split(", ") if item)
    return {int(bit): (severity, name) for bit, severity, name in parts}
