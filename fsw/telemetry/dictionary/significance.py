"""Hazards of telecommands, and verification that differs from the default.

A table gives name, level, and the text that a ground display shows before it sends the telecommand.
A telecommand that is not in the table is NORMAL.
"""

from collections.abc import Iterable
from dataclasses import replace

from fsw.telemetry.dictionary.types import Significance, Telecommand

_VITAL, _CRITICAL = Significance.VITAL, Significance.CRITICAL

HAZARDS: dict[str, tuple[Significance, str]] = {
    "RESTART": (_CRITICAL, "the daemon ends and starts again; nothing is measured meanwhile"),
    "TBL_ACTIVATE": (
        _CRITICAL,
        "other data are in force; ROBOT and NOISE return the estimate to its prior",
    ),
    "TBL_ROLLBACK": (
        _CRITICAL,
        "other data are in force; ROBOT and NOISE return the estimate to its prior",
    ),
    "SET_MODE": (_VITAL, "SAFE and STANDBY stop the identification; SAFE ends a batch job"),
    "START_IDENTIFICATION": (_VITAL, "the present estimate is discarded"),
    "STOP_IDENTIFICATION": (_VITAL, "new data no longer reach the estimate"),
    "RESET_ESTIMATOR": (_VITAL, "the present estimate is discarded"),
    "RESTORE_STATE": (_VITAL, "the present estimate is discarded"),
    "ADOPT_RESULT": (_VITAL, "the present estimate is discarded"),
    "ABORT_BATCH": (_VITAL, "the work of the batch job is lost"),
    "CLEAR_HEALTH": (_VITAL, "the record of past faults in the health word is lost"),
    "REC_STOP": (_VITAL, "measurements after it are not recorded"),
    "SET_PARAMETERS": (_VITAL, "in force at once and kept over restarts"),
    "DELETE_FILE": (_VITAL, "the file cannot be brought back"),
    "ABORT_TRANSFER": (_VITAL, "what the transfer has brought so far is lost"),
    "DISABLE_SCHEDULE": (_VITAL, "time-tagged commands that come due are discarded"),
    "RESET_SCHEDULE": (_VITAL, "all time-tagged commands are discarded"),
    "DELETE_ACTIVITY": (_VITAL, "a time-tagged command is discarded"),
    "DISABLE_MONITORING": (_VITAL, "no limit is checked and no reaction is taken on board"),
    "DISABLE_MONITOR": (_VITAL, "this limit is not checked and its reaction not taken on board"),
}
WITH_PROGRESS = (1, 3, 5, 7)
SLOW: dict[str, tuple[tuple[int, ...], float]] = {  # reports, longest time until the last [s]
    "RUN_BATCH": (WITH_PROGRESS, 3600.0),
    "RUN_PLAN": (WITH_PROGRESS, 3600.0),
    "DOWNLINK_FILE": ((1, 3, 7), 3600.0),
    "DOWNLINK_PIECE": ((1, 3, 7), 3600.0),
    "COPY_FILE": ((1, 3, 7), 600.0),
    "APPEND_FILE": ((1, 3, 7), 600.0),
    "REPORT_FILE_ATTRIBUTES": ((1, 3, 7), 600.0),
    "CHECK_OBJECT": ((1, 3, 7), 600.0),
}


def annotated(telecommands: Iterable[Telecommand]) -> tuple[Telecommand, ...]:
    """Return the telecommands with level, hazard and verification added. Raises KeyError."""
    found = {item.name: item for item in telecommands}
    for name, (level, words) in HAZARDS.items():
        found[name] = replace(found[name], significance=level, hazard=words)
    for name, (reports, timeout_s) in SLOW.items():
        found[name] = replace(found[name], verification=reports, timeout_s=timeout_s)
    return tuple(found.values())
