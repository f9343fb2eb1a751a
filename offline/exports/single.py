"""Telecommands in a form that ground tools can describe: no groups, one type per argument.

A telecommand with a repeated group has exactly one element here, and SET_PARAMETERS becomes one
command per parameter. For groups, XTCE and COSMOS have no form that all readers understand alike.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from fsw.telemetry.dictionary import Dictionary, Field, Parameter, Telecommand

SET_PARAMETERS = "SET_PARAMETERS"


@dataclass(frozen=True, slots=True, kw_only=True)
class SingleCommand:
    """One command: `arguments` in the order on the wire, `fixed` values of some by name."""

    name: str
    telecommand: Telecommand
    arguments: tuple[Field, ...]
    fixed: Mapping[str, int]


def single_commands(dictionary: Dictionary) -> Iterator[SingleCommand]:
    """Yield the single commands of all telecommands of the dictionary."""
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
    """Return the command that sets one parameter, with a value of the parameter's type."""
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
