"""Enumerations of the link: errors of telecommands, mode, functions, methods, states."""

from enum import IntEnum

from fsw.telemetry.dictionary.types import Enumeration

APID_TIME = 0
APID_ESTIMATOR = 100
APID_FILES = 101
APID_SCIENCE = 102


class Error(IntEnum):
    """Reason for which a telecommand was rejected or failed."""

    NONE = 0
    BAD_CRC = 1
    BAD_LENGTH = 2
    WRONG_APID = 3
    UNKNOWN_SERVICE = 4
    UNKNOWN_SUBTYPE = 5
    BAD_ARG = 6
    OUT_OF_RANGE = 7
    WRONG_MODE = 8
    BUSY = 9
    NOT_STAGED = 10
    NOT_VALIDATED = 11
    FILE_NOT_FOUND = 12
    CRC_MISMATCH = 13
    NOT_AUTHENTICATED = 14
    REPLAY = 15
    TIMEOUT = 16
    NOT_CONVERGED = 17
    INSUFFICIENT_EXCITATION = 18
    NOT_SUPPORTED = 19  # this daemon was not configured for it
    FAILED = 20  # it was accepted and tried; an event with it reports the reason
    NOT_AUTHORISED = 21  # this key or port may only observe, not command
    NOT_KEPT = 22  # the disk does not keep the frame's number; only what frees space is accepted


class Mode(IntEnum):
    """Modes of the daemon."""

    BOOT = 0
    SAFE = 1
    STANDBY = 2
    IDENTIFY = 3
    BATCH = 4


class Function(IntEnum):
    """Functions of service 8."""

    SET_MODE = 1
    RESET_COUNTERS = 2
    CLEAR_HEALTH = 3
    REPORT_VERSION = 4
    RESTART = 5
    EVENT_LOG_DUMP = 6
    SECURITY_LOG_DUMP = 7
    COMMAND_LOG_DUMP = 8
    LOAD_KEYS = 9
    START_IDENTIFICATION = 10
    STOP_IDENTIFICATION = 11
    RESET_ESTIMATOR = 12
    SETTLE_ESTIMATOR = 13
    REPORT_DIAGNOSIS = 14
    SAVE_STATE = 15
    RESTORE_STATE = 16
    RUN_BATCH = 20
    ABORT_BATCH = 21
    ADOPT_RESULT = 22
    RUN_PLAN = 23
    TBL_LOAD = 30
    TBL_DATA = 31
    TBL_LOAD_FILE = 32
    TBL_VALIDATE = 33
    TBL_ACTIVATE = 34
    TBL_DUMP = 35
    TBL_ABORT = 36
    TBL_ROLLBACK = 37
    REC_START = 40
    REC_STOP = 41
    DOWNLINK_FILE = 42
    DOWNLINK_PIECE = 60
    APPEND_FILE = 61
    REPORT_TRANSFERS = 62
    REPORT_FREE_SPACE = 63


class Table(IntEnum):
    """Tables of the daemon."""

    ROBOT = 1
    NOISE = 2
    RATES = 3
    MONITORS = 4


class CommandOutcome(IntEnum):
    """Outcome of a command."""

    ACCEPTED = 0  # not finished yet
    COMPLETED = 1
    FAILED = 2
    REJECTED = 3
    INTERRUPTED = 4  # the daemon ended before the command did


class Store(IntEnum):
    """Packet stores of service 15."""

    EVENTS = 1
    HOUSEKEEPING = 2
    SCIENCE = 3


class Memory(IntEnum):
    """Memories of service 6: kinds of objects whose checksum can be requested."""

    TABLES = 1
    FILES = 2


class SequenceStatus(IntEnum):
    """Execution status of a request sequence."""

    INACTIVE = 0
    EXECUTING = 1


def _of(name: str, values: type[IntEnum]) -> Enumeration:
    return Enumeration(name=name, labels={int(item): item.name for item in values})


ERROR = _of("error", Error)
MODE = _of("mode", Mode)
FUNCTION = _of("function", Function)
TABLE = _of("table", Table)
STORE = _of("store", Store)
COMMAND_OUTCOME = _of("command_outcome", CommandOutcome)
MEMORY = _of("memory", Memory)
SEQUENCE_STATUS = _of("sequence_status", SequenceStatus)
FILE_KIND = Enumeration(name="file_kind", labels={0: "FILE", 1: "FOLDER", 2: "OTHER"})
TRANSFER_STATE = Enumeration(
    name="transfer_state",
    labels={0: "NONE", 1: "WAITING", 2: "SENDING", 3: "RECEIVING", 4: "SUSPENDED"},
)
YES_NO = Enumeration(name="yes_no", labels={0: "NO", 1: "YES"})
METHOD = Enumeration(
    name="method",
    labels={0: "NONE", 1: "MRNEA", 2: "RDA", 3: "CM", 4: "CE", 5: "FUSED", 6: "PLAN"},
)
UNKNOWN = Enumeration(name="unknown", labels={0: "CONFIGURED", 1: "BASE", 2: "TARGET", 3: "BOTH"})
JOB_STATE = Enumeration(
    name="job_state", labels={0: "NONE", 1: "RUNNING", 2: "DONE", 3: "FAILED", 4: "ABORTED"}
)
RESULT_STATUS = Enumeration(
    name="result_status",
    labels={
        0: "NONE",
        1: "OK",
        2: "NOT_CONVERGED",
        3: "INSUFFICIENT_EXCITATION",
        4: "ABORTED",
        5: "MODEL_MISMATCH",
        6: "TOO_FEW_BLOCKS",
        7: "PRIOR_CONFLICT",
        8: "NOT_CONSISTENT",
        255: "OTHER",
    },
)
REASON = Enumeration(
    name="reason",
    labels={
        0: "VALID",
        1: "NO_ESTIMATE",
        2: "TOO_FEW_BLOCKS",
        3: "REOPENED",
        4: "NOT_CONVERGED",
        5: "MODEL_MISMATCH",
        6: "PRIOR_CONFLICT",
        7: "INSUFFICIENT_EXCITATION",
        8: "NOT_CONSISTENT",
        255: "OTHER",
    },
)
TABLE_STATE = Enumeration(
    name="table_state",
    labels={0: "ACTIVE", 1: "LOADING", 2: "STAGED", 3: "VALIDATED", 4: "ACTIVATING"},
)
TABLE_COPY = Enumeration(name="table_copy", labels={0: "ACTIVE", 1: "STAGED", 2: "PREVIOUS"})
RESET_CAUSE = Enumeration(
    name="reset_cause", labels={0: "FIRST_START", 1: "STOPPED", 2: "COMMANDED", 3: "CRASH"}
)
SECURITY = Enumeration(name="tc_security", labels={0: "NONE", 1: "SDLS"})
SEVERITY = Enumeration(name="severity", labels={1: "INFO", 2: "LOW", 3: "MEDIUM", 4: "HIGH"})
CHECK_STATUS = Enumeration(
    name="check_status",
    labels={0: "UNCHECKED", 1: "WITHIN", 2: "BELOW_LOW", 3: "ABOVE_HIGH", 4: "STALE"},
)
MONITOR_ACTION = Enumeration(
    name="monitor_action",
    labels={0: "NONE", 1: "SAFE", 2: "STANDBY", 3: "RESET_ESTIMATOR", 4: "ABORT_BATCH"},
)
ENTRY_STATUS = Enumeration(name="enabled", labels={0: "DISABLED", 1: "ENABLED"})


class Health(IntEnum):
    """Bits of the latched health word; 0 is healthy.

    `severity` is a label of SEVERITY: with HIGH the estimate or its record suffers, with MEDIUM
    somebody should act before it does, with LOW the software has already done what there is to do.
    """

    severity: str

    def __new__(cls, bit: int, severity: str) -> "Health":
        """Return the member of a bit, with its severity."""
        member = int.__new__(cls, bit)
        member._value_ = bit
        member.severity = severity
        return member

    SLIPS = 0, "LOW"
    PORT_LOST = 1, "HIGH"
    SENSOR_REJECTED = 2, "LOW"
    ESTIMATOR_RESET = 3, "HIGH"
    MODEL_MISMATCH = 4, "MEDIUM"
    RECORDER = 5, "HIGH"
    RING_DROPS = 6, "HIGH"
    BATCH_FAILED = 7, "MEDIUM"
    TABLE = 8, "MEDIUM"
    PARAMETER_STORE = 9, "MEDIUM"
    STATE = 10, "MEDIUM"
    LIMIT = 11, "MEDIUM"
    COMMAND_LOSS = 12, "MEDIUM"
    UNCLEAN_RESTART = 13, "LOW"
    LOOP_SILENT = 14, "HIGH"
    LINK = 15, "LOW"
    SERVICE = 16, "HIGH"
    SENSOR_FAULT = 17, "MEDIUM"
    BUS = 18, "MEDIUM"
    SECURITY = 19, "HIGH"
    ESTIMATION = 20, "MEDIUM"
