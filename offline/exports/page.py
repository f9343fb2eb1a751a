"""The dictionary as a page to read, in Markdown."""

from collections.abc import Iterator

from fsw.telemetry.dictionary import DICTIONARY, Dictionary, Enumeration, Field, Packet, Telecommand
from fsw.telemetry.dictionary.codes import Health

COVARIANCE = "covariance"  # its 210 elements share one row of the page

VERIFICATION = """Reports of success come in the order given, the last within the time given; the
failure of a stage has the next subtype, and ends the telecommand. A telecommand that is vital or
critical (ISO 14950) should be confirmed before it is sent; the reason is its hazard."""
ATTENTION = """Attention is for ground displays: bounds that are still good, and labels. Monitors on
board (service 12) are a table of their own."""


def page(dictionary: Dictionary = DICTIONARY) -> str:
    """Return the tables of a dictionary as Markdown."""
    lines = ["", "## Telecommands", ""]
    lines += [VERIFICATION, ""]
    lines += ["| service | name | does | arguments | modes | reports | hazard |"]
    lines += ["|---|---|---|---|---|---|---|"]
    lines += [_telecommand_row(item) for item in dictionary.telecommands]
    lines += ["", "## Parameters (service 20)", ""]
    lines += ["| id | name | type | default | range | modes | |", "|---|---|---|---|---|---|---|"]
    for item in dictionary.parameters:
        bounds = f"{item.minimum:g} to {item.maximum:g} {item.unit}".strip()
        modes = ", ".join(item.accepted_in) or "all"
        lines.append(
            f"| {item.id} | `{item.name}` | {item.type} | {item.default:g} | {bounds} "
            f"| {modes} | {item.doc} |"
        )
    lines += ["", "## Events (service 5)", ""]
    lines += ["| id | code | severity | |", "|---|---|---|---|"]
    lines += [
        f"| {event.id} | `{event.code}` | {event.severity.name.lower()} | {event.doc} |"
        for event in dictionary.events
    ]
    lines += ["", "## Errors (service 1)", "", "| value | name |", "|---|---|"]
    lines += [f"| {value} | `{name}` |" for value, name in dictionary.errors.items()]
    lines += ["", "## Health word", "", "| bit | name | severity |", "|---|---|---|"]
    lines += [f"| {int(bit)} | `{bit.name}` | {bit.severity.lower()} |" for bit in Health]
    lines += ["", "## Telemetry packets", "", ATTENTION]
    for packet in dictionary.packets:
        lines += _packet(packet)
    return "\n".join(lines) + "\n"


def _telecommand_row(item: Telecommand) -> str:
    match = dict(item.match)
    parts = []
    for argument in item.arguments:
        if argument.name in match:
            parts.append(f"{argument.name} {argument.type} = {match[argument.name]}")
        else:
            parts.append(_argument(argument))
    if item.repeats:
        parts.append("repeated after the count")
    modes = ", ".join(item.accepted_in) or "all"
    number, arguments = f"{item.service},{item.subtype}", "; ".join(parts)
    reports = " ".join(f"1,{subtype}" for subtype in item.verification) + f", {item.timeout_s:g} s"
    hazard = f"{item.significance}: {item.hazard}" if item.hazard else ""
    return (
        f"| {number} | `{item.name}` | {item.doc} | {arguments} | {modes} | {reports} | {hazard} |"
    )


def _argument(item: Field) -> str:
    text = f"{item.name} {item.type}"
    text += f"[{item.size}]" if item.size else ""
    if item.enumeration is not None:
        text += f" ({_labels(item.enumeration)})"
    elif item.minimum is not None or item.maximum is not None:
        low = "" if item.minimum is None else f"{item.minimum:g}"
        high = "" if item.maximum is None else f"{item.maximum:g}"
        text += f" {low}..{high}"
    return f"{text} {item.unit}".rstrip() + (f": {item.doc}" if item.doc else "")


def _labels(enumeration: Enumeration) -> str:
    if len(enumeration.labels) > 12:
        return f"one of `{enumeration.name}`"
    return ", ".join(f"{value} {label}" for value, label in enumeration.labels.items())


def _packet(packet: Packet) -> Iterator[str]:
    marks = "".join(f", {name} {value}" for name, value in packet.match)
    yield from ("", f"### {packet.name}", "")
    kind = f"service {packet.service},{packet.subtype}" if packet.secondary_header else "no service"
    yield f"APID {packet.apid}, {kind}{marks}. {packet.doc}."
    if not packet.fields:
        return
    yield from ("", "| byte | field | type | unit | | attention |", "|---|---|---|---|---|---|")
    at = 0
    for item in packet.fields:
        if packet.name != COVARIANCE or not item.name.startswith("cov_"):
            yield _field_row(at, item)
        elif at == _first_element(packet):
            yield f"| {at} | `cov_ROW_COLUMN` | f64 | | {_elements(packet)} elements by row | |"
        at += item.size_bytes


def _field_row(at: int, item: Field) -> str:
    kind = f"{item.type}[{item.size}]" if item.size else str(item.type)
    doc = item.doc
    if item.enumeration is not None:
        doc = f"{doc}: {_labels(item.enumeration)}" if doc else _labels(item.enumeration)
    return f"| {at} | `{item.name}` | {kind} | {item.unit} | {doc} | {_attention(item)} |"


def _attention(item: Field) -> str:
    """Return limits, or labels that need attention, in short if these are all but the first."""
    if item.alarms and item.enumeration is not None:
        if len(item.alarms) == len(item.enumeration.labels) - 1 > 2:
            return f"{item.alarms[0][1].name.lower()}: all but {item.enumeration.labels[0]}"
        return ", ".join(f"{concern.name.lower()}: {label}" for label, concern in item.alarms)
    if item.limits is None:
        return ""
    parts = []
    for word, low, high in (
        ("yellow", item.limits.yellow_low, item.limits.yellow_high),
        ("red", item.limits.red_low, item.limits.red_high),
    ):
        parts += [f"{word} below {low:g}"] if low is not None else []
        parts += [f"{word} above {high:g}"] if high is not None else []
    return ", ".join(parts)


def _first_element(packet: Packet) -> int:
    return sum(item.size_bytes for item in packet.fields if not item.name.startswith("cov_"))


def _elements(packet: Packet) -> int:
    return sum(item.name.startswith("cov_") for item in packet.fields)
