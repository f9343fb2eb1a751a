"""The dictionary: defines all packets, telecommands, parameters and events of the link.

It is the only such definition: packing and unpacking (`fsw.telemetry.link.packets`), the exports
and the page to read are all derived from it.
"""

import zlib
from functools import cache

from fsw.telemetry.dictionary.codes import ERROR
from fsw.telemetry.dictionary.commands import TELECOMMANDS
from fsw.telemetry.dictionary.events import EVENTS
from fsw.telemetry.dictionary.files import FILE_REPORTS, FILE_TELECOMMANDS
from fsw.telemetry.dictionary.housekeeping import SETS
from fsw.telemetry.dictionary.onboard_commands import ONBOARD_TELECOMMANDS
from fsw.telemetry.dictionary.onboard_reports import ONBOARD_REPORTS
from fsw.telemetry.dictionary.parameters import PARAMETERS
from fsw.telemetry.dictionary.reports import REPORTS
from fsw.telemetry.dictionary.significance import annotated
from fsw.telemetry.dictionary.types import (
    Concern,
    Dictionary,
    Enumeration,
    EventDefinition,
    Field,
    Limits,
    Packet,
    Parameter,
    Severity,
    Significance,
    Telecommand,
    Type,
)

__all__ = [
    "DICTIONARY",
    "Concern",
    "Dictionary",
    "Enumeration",
    "EventDefinition",
    "Field",
    "Limits",
    "Packet",
    "Parameter",
    "Severity",
    "Significance",
    "Telecommand",
    "Type",
    "dictionary_crc32",
]

DICTIONARY = Dictionary(
    packets=(*SETS, *REPORTS, *FILE_REPORTS, *ONBOARD_REPORTS),
    telecommands=annotated((*TELECOMMANDS, *FILE_TELECOMMANDS, *ONBOARD_TELECOMMANDS)),
    parameters=PARAMETERS,
    events=EVENTS,
    errors=dict(ERROR.labels),
)


@cache
def dictionary_crc32() -> int:
    """Return the CRC-32 of the whole dictionary with its texts; housekeeping reports it."""
    return zlib.crc32(repr(DICTIONARY).encode())
