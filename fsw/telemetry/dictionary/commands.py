"""Telecommands of services 3, 5, 9, 11, 12, 17 and 20, and most functions of service 8."""

from fsw.messages.commands import PLAN_BOUNDS
from fsw.telemetry.dictionary.codes import (
    METHOD,
    MODE,
    TABLE,
    TABLE_COPY,
    UNKNOWN,
    Function,
)
from fsw.telemetry.dictionary.housekeeping import SID
from fsw.telemetry.dictionary.parameters import PARAMETER
from fsw.telemetry.dictionary.shapes import (
    AN_EVENT,
    MONITOR_ID,
    ORIGIN,
    PATH,
    SOURCE,
    function,
    met,
    telecommand,
)
from fsw.telemetry.dictionary.types import Enumeration, Field, Telecommand, Type

MAX_INTERVAL_MS = 3_600_000
MAX_REPEATS = 32  # most elements of a repeated group
_SID = Field(name="sid", type=Type.U16, enumeration=SID)
_TABLE = Field(name="table", type=Type.U8, enumeration=TABLE)
_ENTRIES = Field(name="entries", type=Type.U16, minimum=1, maximum=1000)
_UNKNOWN = Field(name="unknown", type=Type.U8, enumeration=UNKNOWN)
_COUNT = Field(name="count", type=Type.U8, minimum=1, maximum=MAX_REPEATS)
_N = Field(name="n", type=Type.U8, minimum=1, maximum=MAX_REPEATS, doc="elements that follow")
_ID = Field(name="parameter", type=Type.U16, enumeration=PARAMETER)
# what SET_MODE may command; BOOT ends by itself, and a batch job gives BATCH
_COMMANDED_MODE = Enumeration(
    name="commanded_mode",
    labels={n: label for n, label in MODE.labels.items() if label not in ("BOOT", "BATCH")},
)
_METHOD = Enumeration(
    name="batch_method",
    labels={n: label for n, label in METHOD.labels.items() if label not in ("NONE", "PLAN")},
)
_RUNNING = ("STANDBY", "IDENTIFY", "BATCH")
_IDLE = ("STANDBY", "IDENTIFY")
_QUIET = ("SAFE", "STANDBY")


def _each(service: int, subtype: int, name: str, doc: str, *element: Field) -> Telecommand:
    """Return a telecommand with the count N of the standard, followed by N elements."""
    return telecommand(service, subtype, name, doc, _N, *element, repeats=True)


def _bounded(name: str, kind: Type, unit: str, doc: str) -> Field:
    """Return an argument of RUN_PLAN with its bounds."""
    least, most, _ = PLAN_BOUNDS[name]
    return Field(name=name, type=kind, unit=unit, minimum=least, maximum=most, doc=doc)


_SERVICES = (
    _each(3, 5, "ENABLE_SET", "Report a set periodically", _SID),
    _each(3, 6, "DISABLE_SET", "Stop reporting a set periodically", _SID),
    _each(3, 27, "REPORT_SET", "Report a set once, now", _SID),
    _each(
        3,
        31,
        "SET_INTERVAL",
        "Change how often a set is reported",
        _SID,
        Field(name="interval_ms", type=Type.U32, unit="ms", minimum=10, maximum=MAX_INTERVAL_MS),
    ),
    _each(3, 33, "REPORT_SET_PROPERTIES", "Tell how a set is reported", _SID),
    _each(5, 5, "ENABLE_EVENT", "Report an event", AN_EVENT),
    _each(
        5, 6, "DISABLE_EVENT", "Do not report an event; it is still logged and counted", AN_EVENT
    ),
    telecommand(5, 7, "REPORT_DISABLED_EVENTS", "Tell which events are not reported"),
    telecommand(
        9,
        1,
        "SET_TIME_REPORT_RATE",
        "A time packet every 2^exponent s",
        Field(name="exponent", type=Type.U8, minimum=0, maximum=8),
    ),
    telecommand(11, 1, "ENABLE_SCHEDULE", "Release time-tagged commands"),
    telecommand(
        11, 2, "DISABLE_SCHEDULE", "Do not release them; those that come due are discarded"
    ),
    telecommand(11, 3, "RESET_SCHEDULE", "Discard all time-tagged commands"),
    _each(
        11,
        4,
        "INSERT_ACTIVITY",
        "Keep telecommands for a mission elapsed time",
        *met("release"),
        Field(
            name="telecommand",
            type=Type.BYTES,
            doc="a whole packet with its CRC; its header states its length",
        ),
    ),
    _each(11, 5, "DELETE_ACTIVITY", "Discard time-tagged commands", SOURCE, *ORIGIN),
    telecommand(11, 17, "REPORT_SCHEDULE", "Tell what waits"),
    _each(12, 1, "ENABLE_MONITOR", "Check a monitor", MONITOR_ID),
    _each(12, 2, "DISABLE_MONITOR", "Do not check a monitor", MONITOR_ID),
    _each(12, 8, "REPORT_MONITOR", "Tell a monitor's definition", MONITOR_ID),
    telecommand(12, 13, "REPORT_MONITOR_STATUS", "Tell the status of all monitors"),
    telecommand(12, 15, "ENABLE_MONITORING", "Check monitors at all"),
    telecommand(12, 16, "DISABLE_MONITORING", "Check none"),
    telecommand(17, 1, "PING", "Answer with 17,2"),
    telecommand(20, 1, "REPORT_PARAMETERS", "Tell values of parameters", _COUNT, _ID, repeats=True),
    telecommand(
        20,
        3,
        "SET_PARAMETERS",
        "Set parameters, all or none; every value in its own type",
        _COUNT,
        _ID,
        Field(name="value", type=Type.BYTES),
        repeats=True,
    ),
)

_FUNCTIONS = (
    function(
        Function.SET_MODE,
        "Go to a mode",
        Field(name="mode", type=Type.U8, enumeration=_COMMANDED_MODE),
    ),
    function(Function.RESET_COUNTERS, "Command, event and link counters to zero"),
    function(
        Function.CLEAR_HEALTH,
        "Clear latched bits of the health word",
        Field(name="mask", type=Type.U32, doc="bits to clear; 0xFFFFFFFF: all"),
    ),
    function(Function.REPORT_VERSION, "Tell package, commit and CRCs"),
    function(
        Function.RESTART,
        "End and start again; the key guards against accidents",
        Field(name="key", type=Type.U16, minimum=0xB007, maximum=0xB007),
        accepted_in=_QUIET,
    ),
    function(Function.EVENT_LOG_DUMP, "Report the newest entries of the event log", _ENTRIES),
    function(
        Function.SECURITY_LOG_DUMP,
        "Report the newest entries of the security log: connections and refusals",
        _ENTRIES,
    ),
    function(
        Function.COMMAND_LOG_DUMP,
        "Report the newest entries of the command log: who sent what, when, and its outcome",
        _ENTRIES,
    ),
    function(
        Function.START_IDENTIFICATION,
        "Identify these bodies, from the prior",
        _UNKNOWN,
        accepted_in=_IDLE,
    ),
    function(Function.STOP_IDENTIFICATION, "Rest; the last estimate stays", accepted_in=_RUNNING),
    function(Function.RESET_ESTIMATOR, "Back to the prior", accepted_in=_RUNNING),
    function(Function.SETTLE_ESTIMATOR, "Settle completely and publish", accepted_in=_RUNNING),
    function(Function.REPORT_DIAGNOSIS, "Diagnose the estimate"),
    function(Function.SAVE_STATE, "Save the estimator's state now"),
    function(Function.RESTORE_STATE, "Go back to the newest saved state", accepted_in=_IDLE),
    function(
        Function.RUN_BATCH,
        "Run a batch method on stored windows",
        Field(name="method", type=Type.U8, enumeration=_METHOD),
        _UNKNOWN,
        Field(
            name="last_s",
            type=Type.F32,
            unit="s",
            minimum=0.0,
            maximum=1e6,
            doc="newest so many seconds; 0: the parameter batch_last_s",
        ),
        accepted_in=_RUNNING,
    ),  # rejected as BUSY while a job runs
    function(
        Function.RUN_PLAN,
        "Plan the next motion from the present estimate, within excitation.limits",
        _bounded("duration_s", Type.F32, "s", "of the motion"),
        _bounded("starts", Type.U8, "", "of the search; the best is taken"),
        _bounded("seed", Type.U16, "", "of the search; the same seed gives the same motion"),
        accepted_in=_RUNNING,
    ),  # rejected as BUSY while a job runs
    function(Function.ABORT_BATCH, "End the batch job"),
    function(
        Function.ADOPT_RESULT,
        "Make the batch result the online estimator's prior",
        accepted_in=_RUNNING,
    ),
    function(
        Function.TBL_LOAD,
        "Begin to load a table",
        _TABLE,
        Field(name="size_bytes", type=Type.U32, unit="B", minimum=1, maximum=1 << 20),
        Field(name="crc32", type=Type.U32),
    ),
    function(
        Function.TBL_DATA,
        "A piece of the table that is being loaded",
        _TABLE,
        Field(name="offset", type=Type.U32, unit="B"),
        Field(name="data", type=Type.BYTES),
    ),
    function(
        Function.TBL_LOAD_FILE,
        "Load a table from a file that came up",
        _TABLE,
        Field(name="crc32", type=Type.U32),
        PATH,
    ),
    function(Function.TBL_VALIDATE, "Check the staged table", _TABLE),
    function(
        Function.TBL_ACTIVATE,
        "Use the validated table from the next tick on",
        _TABLE,
        Field(name="crc32", type=Type.U32, doc="of the table meant"),
        accepted_in=_QUIET,
    ),
    function(
        Function.TBL_DUMP,
        "Write a table to a file",
        _TABLE,
        Field(name="copy", type=Type.U8, enumeration=TABLE_COPY),
    ),
    function(Function.TBL_ABORT, "Drop the staged table", _TABLE),
    function(
        Function.TBL_ROLLBACK, "Use the table before this one again", _TABLE, accepted_in=_QUIET
    ),
    function(Function.REC_START, "Begin a recording"),
    function(Function.REC_STOP, "Close the recording"),
    function(Function.LOAD_KEYS, "Read the key files of the link again and use them"),
)

TELECOMMANDS = (*_SERVICES, *_FUNCTIONS)
