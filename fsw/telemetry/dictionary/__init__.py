"""The dictionary: everything that crosses the link, and from which everything else is made.

Pack and unpack (`fsw.telemetry.link.packets`), the exports and the human page read these values and
nothing else; there is no second list.
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
    """Return the CRC-32 of all names, types and numbers; it goes down in housekeeping."""
    return zlib.crc32(repr(DICTIONARY).encode())
