"""Telecommands as ground tools know them: no repeated groups, every argument of one type.

A telecommand with a repeated group becomes the one with a single element, and SET_PARAMETERS one
command a parameter: neither XTCE nor COSMOS has a form for groups that readers agree on.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from fsw.telemetry.dictionary import Dictionary, Field, Parameter, Telecommand

SET_PARAMETERS = "SET_PARAMETERS"


@dataclass(frozen=True, slots=True, kw_only=True)
class SingleCommand:
    """One command; `arguments` are in their order on the wire, `fixed` has the values of some."""

    name: str
    telecommand: Telecommand
    arguments: tuple[Field, ...]
    fixed: Mapping[str, int]


def single_commands(dictionary: Dictionary) -> Iterator[SingleCommand]:
    """Yield every command of the dictionary."""
    for item in dictionary.telecommands:
        fixed = dict(item.match)
        if item.name == SET_PARAMETERS:
            for parameter in dictionary.parameters:
                yield _setting(item, parameter)
            continue
        if item.repeats:
            fixed |= {item.arguments[0].name: 1}
        yield SingleCommand(name=item.name, telecommand=item, arguments=item.arguments, fixed=fixed)


def _setting(item: Telecommand, parameter: Parameter) -> SingleCommand:
    """Return the command that sets one parameter in its own type."""
    count, number, value = item.arguments
    value = replace(
        value,
        type=parameter.type,
        unit=parameter.unit,
        doc=parameter.doc,
        minimum=parameter.minimum,
        maximum=parameter.maximum,
    )
    return SingleCommand(
        name=f"SET_{parameter.name}",
        telecommand=item,
        arguments=(count, number, value),
        fixed={count.name: 1, number.name: parameter.id},
    )
