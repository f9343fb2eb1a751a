"""Telemetry packets except housekeeping sets, file reports and onboard_reports."""

from dataclasses import replace

from fsw.telemetry.dictionary.codes import (
    APID_TIME,
    CHECK_STATUS,
    COMMAND_OUTCOME,
    ENTRY_STATUS,
    ERROR,
    SEVERITY,
    TABLE,
    YES_NO,
)
from fsw.telemetry.dictionary.events import EVENT
from fsw.telemetry.dictionary.fields import YELLOW, choice, number, text
from fsw.telemetry.dictionary.housekeeping import PATH_BYTES, SID, TEXT_BYTES
from fsw.telemetry.dictionary.parameters import PARAMETER, PARAMETERS, VALUE
from fsw.telemetry.dictionary.shapes import AN_EVENT, report
from fsw.telemetry.dictionary.types import Field, Limits, Packet, Severity, Type

DISABLED_SLOTS = 16
N = number("n", Type.U8, doc="the standard's N: 1; 0: there is none, and the rest is 0")
LOG_TEXT_BYTES = 120
WHO_BYTES = 64
VERDICT_BYTES = 240

_REQUEST = (
    number("request_packet_id", Type.U16, doc="first two bytes of the telecommand"),
    number("request_sequence", Type.U16, doc="bytes three and four of the telecommand"),
)
_FAILURE = (
    Field(name="error", type=Type.U16, enumeration=ERROR),
    number("error_argument", Type.U16, doc="which argument, from 1; 0: none in particular"),
    number("error_value", Type.F64, doc="its value, or the one expected; 0: none"),
)
_STEP = (number("step", Type.U16, doc="progress in percent"),)
CUC = (
    number("p_field", Type.U8, doc="0x2F: 4 bytes of seconds, 3 of fraction, own epoch"),
    number("coarse_s", Type.U32, "s"),
    number("fine", Type.U24, doc="2^-24 s"),
)


def _verification(subtype: int, name: str, doc: str, *fields: Field) -> Packet:
    return report(1, subtype, name, doc, *_REQUEST, *fields)


_VERIFICATION = (
    _verification(1, "acceptance_success", "The telecommand was accepted"),
    _verification(2, "acceptance_failure", "The telecommand was rejected", *_FAILURE),
    _verification(3, "start_success", "Its execution has begun"),
    _verification(4, "start_failure", "Its execution could not begin", *_FAILURE),
    _verification(5, "progress_success", "Its execution continues", *_STEP),
    _verification(6, "progress_failure", "A step of it failed", *_STEP, *_FAILURE),
    _verification(7, "completion_success", "It is done"),
    _verification(8, "completion_failure", "It failed", *_FAILURE),
    _verification(10, "routing_failure", "It is addressed to nobody here", *_FAILURE),
)

EVENT_FIELDS = (
    AN_EVENT,
    number("occurrence", Type.U32, doc="of this event since the counters were reset"),
    number("suppressed", Type.U32, doc="of this event, held back by its throttle since the last"),
    text("text", TEXT_BYTES),
)

_EVENTS = tuple(
    report(
        5,
        int(severity),
        f"event_{severity.name.lower()}",
        f"An event of severity {severity.name.lower()}",
        *EVENT_FIELDS,
    )
    for severity in Severity
)

_PARAMETERS = tuple(
    replace(
        report(
            20,
            2,
            f"parameter_{item.name}",
            f"Value of the parameter {item.name}",
            N,
            Field(name="parameter", type=Type.U16, enumeration=PARAMETER),
            Field(name=item.name, type=item.type, unit=item.unit, doc=item.doc),
        ),
        match=(("parameter", item.id),),
    )
    for item in PARAMETERS
)

_OTHERS = (
    report(
        3,
        35,
        "set_properties",
        "How a housekeeping set is reported",
        N,
        Field(name="sid", type=Type.U16, enumeration=SID),
        choice("periodic", YES_NO),
        number("interval_ms", Type.U32, "ms"),
    ),
    report(
        5,
        8,
        "disabled_events",
        "Events that are not reported; 0 after the first n",
        number("n", Type.U8, doc="events in this report"),
        *(
            Field(name=f"event_{k}", type=Type.U16, enumeration=EVENT)
            for k in range(1, DISABLED_SLOTS + 1)
        ),
    ),
    report(
        8,
        130,
        "version",
        "What is running",
        text("package", 32, "package and version"),
        text("commit", 41, "commit of the source; empty where not known"),
        text("python", 16),
        number("config_crc32", Type.U32),
        number("dictionary_crc32", Type.U32),
        number("boot_count", Type.U32),
    ),
    report(
        8,
        131,
        "event_log_entry",
        "One entry of the event log, oldest first",
        number("entry", Type.U16, doc="from 1; 0: the log is empty"),
        number("entries", Type.U16),
        number("time_s", Type.F64, "s", "mission elapsed time"),
        choice("severity", SEVERITY),
        AN_EVENT,
        number("boot_count", Type.U32, doc="start of the daemon in which it happened"),
        text("text", LOG_TEXT_BYTES),
    ),
    report(
        8,
        134,
        "command_log_entry",
        "One command of the command log, oldest first",
        number("entry", Type.U16, doc="from 1; 0: the log is empty"),
        number("entries", Type.U16),
        number("boot_count", Type.U32, doc="start of the daemon in which it was received"),
        number("time_s", Type.F64, "s", "mission elapsed time of that run"),
        number("unix_s", Type.F64, "s", "Unix time"),
        number("duration_s", Type.F32, "s", "until its end"),
        choice("outcome", COMMAND_OUTCOME),
        Field(name="error", type=Type.U16, enumeration=ERROR),
        text("who", WHO_BYTES, "client and key, or the part of the daemon that released it"),
        text("command", 32),
        text("arguments", LOG_TEXT_BYTES),
    ),
    report(
        8,
        132,
        "diagnosis",
        "Diagnosis of the estimate, in words and numbers",
        number("duration_s", Type.F64, "s", "of the data used"),
        number("blocks", Type.U32),
        choice("valid", YES_NO),
        number("noise_ratio", Type.F64),
        number("innovation_lag1", Type.F64),
        number("innovation_lag1_bound", Type.F64),
        text("verdict", VERDICT_BYTES),
        text("parameters", VERDICT_BYTES, "of each body: which are measured, which are not"),
    ),
    Packet(
        name="time",
        apid=APID_TIME,
        service=9,
        subtype=2,
        doc="Mission elapsed time when this packet was made; without secondary header",
        fields=(
            number("rate_exponent", Type.U8, doc="a report every 2^this s"),
            *CUC,
            number("time_status", Type.U8, doc="0: steered by nothing; UTC: time_correlation"),
        ),
        secondary_header=False,
    ),
    report(
        9,
        128,
        "time_correlation",
        "UTC of this packet's own time stamp; after every time packet",
        number("utc_unix_ns", Type.U64, "ns", "since 1970, leap seconds not counted"),
        number(
            "uncertainty_s",
            Type.F32,
            "s",
            "largest error of it",
            Limits(yellow_high=1.0),
        ),
        choice("synchronised", YES_NO, "clock of the machine steered by UTC", NO=YELLOW),
        text("epoch_utc", 32, "UTC of mission elapsed time 0, the epoch of the CUC"),
    ),
    report(
        11,
        13,
        "schedule_entry",
        "One time-tagged command that waits",
        N,
        number("release_time_s", Type.F64, "s", "mission elapsed time"),
        number("source_id", Type.U16, doc="of the telecommand"),
        number("apid", Type.U16),
        number("sequence_count", Type.U16),
        number("service", Type.U8),
        number("subtype", Type.U8),
    ),
    report(
        12,
        9,
        "monitor_definition",
        "Definition of one monitor",
        N,
        number("monitor", Type.U16),
        Field(name="value", type=Type.U16, enumeration=VALUE),
        choice("enabled", ENTRY_STATUS),
        number("low", Type.F64),
        number("high", Type.F64),
        number("repetitions", Type.U16, doc="consecutive violations before it reports"),
        number("stale_s", Type.F32, "s"),
        text("action", 24, "what it does, once"),
    ),
    report(
        12,
        12,
        "check_transition",
        "A monitored value has left its limits, or is back",
        N,
        number("monitor", Type.U16),
        Field(name="value", type=Type.U16, enumeration=VALUE),
        number("found", Type.F64),
        number("limit", Type.F64),
        choice("before", CHECK_STATUS),
        choice("now", CHECK_STATUS),
        number("time_s", Type.F64, "s", "mission elapsed time"),
    ),
    report(
        12,
        14,
        "monitor_status",
        "Status of one monitor",
        N,
        number("monitor", Type.U16),
        choice("enabled", ENTRY_STATUS),
        choice("status", CHECK_STATUS),
    ),
    report(17, 2, "alive", "Answer to a ping"),
    report(
        8,
        133,
        "table_dumped",
        "A table was written to a file, ready to be fetched",
        Field(name="table", type=Type.U8, enumeration=TABLE),
        number("crc32", Type.U32),
        number("size_bytes", Type.U32, "B"),
        text("path", PATH_BYTES),
    ),
)

REPORTS = (*_VERIFICATION, *_EVENTS, *_PARAMETERS, *_OTHERS)
