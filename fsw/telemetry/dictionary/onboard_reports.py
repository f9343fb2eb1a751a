"""Telemetry packets of the services that work without the ground: 6, 15, 19, 21, and 11,10.

A packet reports one object: N is 1, or 0 if there is none (sequence_entry: the number of entries).
Stored telecommands are hexadecimal text: packets have a fixed size, and readers no type for bytes.
"""

from fsw.telemetry.dictionary.codes import (
    ENTRY_STATUS,
    MEMORY,
    SEQUENCE_STATUS,
    STORE,
    YES_NO,
)
from fsw.telemetry.dictionary.fields import choice, number, text
from fsw.telemetry.dictionary.housekeeping import PATH_BYTES
from fsw.telemetry.dictionary.onboard_commands import MAX_REQUEST_BYTES
from fsw.telemetry.dictionary.shapes import AN_EVENT, report
from fsw.telemetry.dictionary.types import Type

_N = number("n", Type.U8, doc="1; 0: there is none")
_HEX = text("request_hex", 2 * MAX_REQUEST_BYTES + 1, "the telecommand packet, hexadecimal")
_APID = number("apid", Type.U16)
_TIME = "mission elapsed time"


ONBOARD_REPORTS = (
    report(
        6,
        8,
        "object_checked",
        "Check-sum of a table or file",
        choice("memory", MEMORY),
        text("base", PATH_BYTES),
        _N,
        number("offset", Type.U32, "B"),
        number("length", Type.U32, "B", "of what was checked"),
        number("crc32", Type.U32, doc="CRC-32 of ISO 3309, as of tables and file delivery"),
    ),
    report(
        11,
        10,
        "schedule_detail",
        "One time-tagged command that waits, with the telecommand itself",
        _N,
        number("release_time_s", Type.F64, "s", _TIME),
        _HEX,
    ),
    report(
        15,
        13,
        "store_content",
        "Content of one packet store",
        _N,
        choice("store", STORE),
        number("oldest_s", Type.F64, "s", f"{_TIME} of the oldest packet; 0: empty"),
        number("newest_s", Type.F64, "s", f"{_TIME} of the newest packet; 0: empty"),
        number("filled_percent", Type.U8),
        number("stored_bytes", Type.U64, "B"),
        number("size_bytes", Type.U64, "B"),
    ),
    report(
        15,
        19,
        "store_status",
        "Status of one packet store",
        _N,
        choice("store", STORE),
        choice("enabled", ENTRY_STATUS, "storage"),
        choice("playing_back", YES_NO, "a retrieval by time range is under way"),
        number("failed", Type.U32, doc="packets that could not be stored"),
    ),
    report(
        19,
        7,
        "event_action_status",
        "Status of the action of one event",
        _N,
        _APID,
        AN_EVENT,
        choice("enabled", ENTRY_STATUS),
        choice("function_enabled", ENTRY_STATUS, "whether events release actions at all"),
        number("released", Type.U32, doc="times since the daemon started"),
    ),
    report(
        19,
        11,
        "event_action",
        "The action of one event",
        _N,
        _APID,
        AN_EVENT,
        choice("enabled", ENTRY_STATUS),
        _HEX,
    ),
    report(
        21,
        7,
        "sequence_status",
        "Execution status of one sequence",
        _N,
        number("sequence", Type.U8),
        choice("status", SEQUENCE_STATUS),
        number("released", Type.U8, doc="entries of this execution, or of the last one"),
        number("entries", Type.U8),
    ),
    report(
        21,
        10,
        "sequence_checked",
        "Check-sum of one sequence",
        number("sequence", Type.U8),
        number("crc32", Type.U32, doc="over its entries as they were loaded"),
        number("size_bytes", Type.U32, "B"),
    ),
    report(
        21,
        12,
        "sequence_entry",
        "One entry of a sequence",
        number("sequence", Type.U8),
        number("n", Type.U8, doc="entries"),
        number("entry", Type.U8, doc="from 1"),
        number("delay_ms", Type.U32, "ms", "after this telecommand"),
        _HEX,
    ),
    report(
        21,
        14,
        "sequence_aborted",
        "A sequence that was aborted with all others",
        _N,
        number("sequence", Type.U8),
    ),
)
