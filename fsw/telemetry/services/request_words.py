"""Text of a telecommand's arguments, for events and the command log."""

from fsw.telemetry.link.telecommands import Request


def argument_words(request: Request) -> str:
    """Return the arguments of a request as NAME=VALUE; of a BYTES argument only its size."""
    if request.elements:  # of a repeated group
        return "; ".join(argument_words(element) for element in request.elements)
    fixed = dict(request.telecommand.match)
    parts = []
    for field in request.telecommand.arguments:
        if field.name in fixed or field.name not in request.values:
            continue
        value = request.values[field.name]
        labels = field.enumeration.labels if field.enumeration is not None else {}
        shown = labels.get(value, value) if isinstance(value, int) else value
        parts.append(
            f"{field.name}={shown:g}" if isinstance(shown, float) else f"{field.name}={shown}"
        )
    if request.data:
        parts.append(f"{len(request.data)} bytes")
    parts += [f"{item.name}={value:g}" for item, value in request.parameters]
    return " ".join(parts)
