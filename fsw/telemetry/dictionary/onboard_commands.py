"""Telecommands of the services that work without the ground: 6, 15, 19, 21 and parts of 11, 12.

In most of them the standard repeats a group N times. Here N is on the wire but always 1: each
telecommand names one object, so that each object has its own acceptance and completion report.
"""

from dataclasses import replace

from fsw.telemetry.dictionary.codes import MEMORY, MONITOR_ACTION, STORE
from fsw.telemetry.dictionary.housekeeping import PATH_BYTES
from fsw.telemetry.dictionary.parameters import VALUE
from fsw.telemetry.dictionary.shapes import AN_EVENT, MONITOR_ID, ORIGIN, PATH, met, telecommand
from fsw.telemetry.dictionary.types import Field, Significance, Telecommand, Type

MAX_REQUEST_BYTES = 256  # most bytes of a telecommand that is stored on board
MAX_SEQUENCES = 16
LARGEST = 1.7976931348623157e308  # a limit of this size stands for no limit
DAY_S = 86_400

N = Field(name="n", type=Type.U8, minimum=1, maximum=1, doc="number of objects: 1")
_STORE = Field(name="store", type=Type.U8, enumeration=STORE)
_APID = Field(name="apid", type=Type.U16, minimum=100, maximum=100)
_SEQUENCE = Field(name="sequence", type=Type.U8, minimum=1, maximum=MAX_SEQUENCES)
_REQUEST = Field(
    name="request",
    type=Type.BYTES,
    doc=f"a whole telecommand packet with its CRC, {MAX_REQUEST_BYTES} bytes at most",
)
_REQUEST_ID = (
    Field(name="source_id", type=Type.U16, doc="source id of the telecommand"),
    *ORIGIN,
)
_OFFSET = (
    Field(
        name="offset_coarse_s",
        type=Type.I32,
        unit="s",
        minimum=-366 * DAY_S,
        maximum=366 * DAY_S,
        doc="relative CUC 4+3, two's complement: negative is earlier",
    ),
    Field(name="offset_fine", type=Type.U24, doc="2^-24 s"),
)
_MONITOR_DEFINITION = (
    MONITOR_ID,
    Field(name="value", type=Type.U16, enumeration=VALUE),
    Field(name="repetitions", type=Type.U16, minimum=1, maximum=1000),
    Field(name="low", type=Type.F64, doc=f"{-LARGEST!r}: no lower limit"),
    Field(name="high", type=Type.F64, doc=f"{LARGEST!r}: no upper limit"),
    Field(
        name="stale_s",
        type=Type.F32,
        unit="s",
        minimum=0.0,
        maximum=1e6,
        doc="older than this it is reported as stale; 0: never",
    ),
    Field(name="action", type=Type.U8, enumeration=MONITOR_ACTION),
)


def _tc(service: int, subtype: int, name: str, doc: str, *arguments: Field) -> Telecommand:
    """Return a telecommand; its argument N, if it has one, is fixed to 1."""
    match = (("n", 1),) if N in arguments else ()
    return replace(telecommand(service, subtype, name, doc, *arguments), match=match)


_MEMORY = (
    _tc(
        6,
        7,
        "CHECK_OBJECT",
        "Report the check-sum of a table or file",
        Field(name="memory", type=Type.U8, enumeration=MEMORY),
        Field(
            name="base",
            type=Type.TEXT,
            size=PATH_BYTES,
            doc="of TABLES: NAME/ACTIVE, NAME/STAGED, NAME/PREVIOUS; of FILES: the path",
        ),
        N,
        Field(name="offset", type=Type.U32, unit="B"),
        Field(name="length", type=Type.U32, unit="B", doc="0: to the end"),
    ),
)

_SCHEDULE = (
    _tc(
        11,
        7,
        "SHIFT_ACTIVITY",
        "Release one time-tagged command earlier or later",
        *_OFFSET,
        N,
        *_REQUEST_ID,
    ),
    _tc(11, 15, "SHIFT_SCHEDULE", "Release all time-tagged commands earlier or later", *_OFFSET),
    _tc(11, 16, "REPORT_SCHEDULE_DETAIL", "Report what waits, with the telecommands themselves"),
)

_MONITORS = (
    _tc(
        12,
        5,
        "ADD_MONITOR",
        "Add a monitor, disabled; kept as a new generation of the table MONITORS",
        N,
        *_MONITOR_DEFINITION,
    ),
    _tc(12, 6, "DELETE_MONITOR", "Remove a monitor that is disabled", N, MONITOR_ID),
    _tc(
        12,
        7,
        "MODIFY_MONITOR",
        "Give a monitor another definition; its status begins again",
        N,
        *_MONITOR_DEFINITION,
    ),
)

_PACKET_STORES = (
    _tc(15, 1, "ENABLE_STORE", "Store packets in a packet store", N, _STORE),
    _tc(15, 2, "DISABLE_STORE", "Store none; what is stored stays", N, _STORE),
    _tc(
        15,
        9,
        "PLAY_BACK",
        "Send the stored packets of a time range again, as they were",
        N,
        _STORE,
        *met("from"),
        *met("to"),
    ),
    _tc(
        15,
        11,
        "DELETE_STORED",
        "Delete stored packets up to a time, whole segments only",
        *met("until"),
        N,
        _STORE,
    ),
    _tc(15, 12, "REPORT_STORE_CONTENT", "Report times and filling of a packet store", N, _STORE),
    _tc(15, 17, "ABORT_PLAYBACK", "End the retrieval from a packet store", N, _STORE),
    _tc(15, 18, "REPORT_STORE_STATUS", "Report the status of every packet store"),
)

_EVENT_ACTIONS = (
    _tc(
        19,
        1,
        "ADD_EVENT_ACTION",
        "Keep a telecommand that an event releases; it is disabled at first",
        N,
        _APID,
        AN_EVENT,
        _REQUEST,
    ),
    _tc(19, 2, "DELETE_EVENT_ACTION", "Remove an event's action", N, _APID, AN_EVENT),
    _tc(19, 3, "DELETE_EVENT_ACTIONS", "Remove all actions of events"),
    _tc(19, 4, "ENABLE_EVENT_ACTION", "Let an event release its action", N, _APID, AN_EVENT),
    _tc(19, 5, "DISABLE_EVENT_ACTION", "Let an event release nothing", N, _APID, AN_EVENT),
    _tc(19, 6, "REPORT_EVENT_ACTION_STATUS", "Report the status of every event's action"),
    _tc(19, 8, "ENABLE_EVENT_ACTIONS", "Let events release actions at all"),
    _tc(19, 9, "DISABLE_EVENT_ACTIONS", "Let no event release an action"),
    _tc(19, 10, "REPORT_EVENT_ACTION", "Report an event's action itself", N, _APID, AN_EVENT),
)

_SEQUENCES = (
    _tc(
        21,
        1,
        "LOAD_SEQUENCE",
        "Keep a sequence of telecommands",
        _SEQUENCE,
        Field(
            name="entries",
            type=Type.BYTES,
            doc="each a whole telecommand packet with its CRC, then the delay after it u32 [ms]",
        ),
    ),
    _tc(21, 2, "LOAD_SEQUENCE_FILE", "Keep a sequence from a file", _SEQUENCE, PATH),
    _tc(21, 3, "UNLOAD_SEQUENCE", "Remove a sequence that does not execute", _SEQUENCE),
    _tc(21, 4, "START_SEQUENCE", "Release the telecommands of a sequence", _SEQUENCE),
    _tc(21, 5, "ABORT_SEQUENCE", "Release no more of a sequence", _SEQUENCE),
    _tc(21, 6, "REPORT_SEQUENCES", "Report the execution status of every sequence"),
    _tc(21, 9, "CHECK_SEQUENCE", "Report the check-sum of a sequence", _SEQUENCE),
    _tc(21, 11, "REPORT_SEQUENCE", "Report the content of a sequence", _SEQUENCE),
    _tc(21, 13, "ABORT_SEQUENCES", "Release no more of any sequence, and report which"),
)

_VITAL = {  # telecommand -> its hazard
    "SHIFT_ACTIVITY": "a time-tagged command is released at another time",
    "SHIFT_SCHEDULE": "all time-tagged commands are released at other times",
    "DELETE_MONITOR": "its limit is not checked and its reaction not taken on board",
    "MODIFY_MONITOR": "another limit holds at once",
    "DISABLE_STORE": "packets that nobody receives meanwhile are lost",
    "DELETE_STORED": "the packets cannot be brought back",
    "DELETE_EVENT_ACTION": "its reaction is not taken on board",
    "DELETE_EVENT_ACTIONS": "no reaction is taken on board",
    "DISABLE_EVENT_ACTION": "its reaction is not taken on board",
    "DISABLE_EVENT_ACTIONS": "no reaction is taken on board",
    "ENABLE_EVENT_ACTION": "its event releases a telecommand without the ground",
    "START_SEQUENCE": "its telecommands are released without further confirmation",
    "UNLOAD_SEQUENCE": "the sequence cannot be brought back",
    "ABORT_SEQUENCE": "the rest of its telecommands is not released",
    "ABORT_SEQUENCES": "the rest of their telecommands is not released",
}
_PLAYBACK_S = 3600.0


def _annotated(item: Telecommand) -> Telecommand:
    """Return a telecommand with its significance or its timeout, if not the default ones."""
    if item.name == "PLAY_BACK":
        return replace(item, timeout_s=_PLAYBACK_S)
    if item.name in _VITAL:
        return replace(item, significance=Significance.VITAL, hazard=_VITAL[item.name])
    return item


_TELECOMMANDS = (
    *_MEMORY,
    *_SCHEDULE,
    *_MONITORS,
    *_PACKET_STORES,
    *_EVENT_ACTIONS,
    *_SEQUENCES,
)
ONBOARD_TELECOMMANDS = tuple(_annotated(item) for item in _TELECOMMANDS)
