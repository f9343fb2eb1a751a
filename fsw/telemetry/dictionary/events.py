"""Events of service 5; one without a number of its own goes out as OTHER, its code in the text."""

from __future__ import annotations

from fsw.telemetry.dictionary.types import Enumeration, EventDefinition, Severity

_HIGH, _MEDIUM, _LOW, _INFO = Severity.HIGH, Severity.MEDIUM, Severity.LOW, Severity.INFO

OTHER_ID = 65535
_TABLE: tuple[tuple[int, str, Severity, str], ...] = (
    (1, "STARTED", _INFO, "the daemon has started"),
    (2, "STOPPED", _INFO, "the loop has ended"),
    (3, "REALTIME", _LOW, "the system refused a real-time setting"),
    (4, "SERVICE_LOST", _HIGH, "the service process has ended"),
    (5, "LOOP_LOST", _HIGH, "the loop process has died"),
    (6, "LOOP_SILENT", _HIGH, "no summary from the loop for longer than it should take"),
    (7, "RING_DROPS", _HIGH, "records were lost between loop and service"),
    (8, "RESTART_REQUESTED", _MEDIUM, "a restart was commanded"),
    (10, "PORT_LOST", _HIGH, "a device's link failed"),
    (11, "PORT_BACK", _MEDIUM, "a device's link is open again"),
    (12, "BUS_SWITCHED", _HIGH, "a redundant bus has taken over"),
    (20, "ESTIMATOR_RESET", _HIGH, "the estimate was not proper and began again at the prior"),
    (21, "CHANGE_DETECTED", _MEDIUM, "the parameters changed; the estimate was re-opened"),
    (22, "NOISE_ABOVE_DECLARED", _MEDIUM, "residuals are larger than the declared noise"),
    (23, "PRIOR_CONFLICT", _MEDIUM, "the data contradict the prior, which was widened"),
    (30, "BATCH_DONE", _INFO, "the batch job has a result"),
    (31, "BATCH_FAILED", _MEDIUM, "the batch job has failed"),
    (32, "BATCH_ABORTED", _MEDIUM, "the batch job was aborted"),
    (40, "RECORDER_FAILED", _HIGH, "the recording cannot be written"),
    (41, "BLOCKS_FAILED", _MEDIUM, "blocks for batch jobs cannot be stored"),
    (42, "RECORDING_STARTED", _INFO, "a recording was begun"),
    (43, "RECORDING_STOPPED", _INFO, "a recording was closed"),
    (44, "RECORDER_BACK", _MEDIUM, "the recording goes on after a failure"),
    (50, "MODE_CHANGED", _INFO, "the daemon is in another mode"),
    (51, "COMMAND_LOSS", _HIGH, "no telecommand for longer than the command-loss time"),
    (52, "COMMAND_BACK", _MEDIUM, "a telecommand after a command loss"),
    (53, "HEALTH_LATCHED", _MEDIUM, "a bit of the health word was set"),
    (60, "TC_REJECTED", _LOW, "a telecommand was rejected"),
    (61, "TC_FAILED", _MEDIUM, "an accepted telecommand failed"),
    (62, "TC_GARBAGE", _MEDIUM, "bytes on the link that are no telecommand"),
    (63, "TC_AUTH_FAILED", _HIGH, "a frame did not authenticate"),
    (64, "LINK_OPENED", _INFO, "a ground client has connected"),
    (65, "LINK_CLOSED", _INFO, "a ground client has gone"),
    (66, "LINK_DROPS", _LOW, "packets were dropped for a slow client"),
    (67, "LINK_FAILED", _HIGH, "the telemetry link cannot be opened"),
    (68, "CONTROL_FAILED", _HIGH, "the local control socket cannot be opened"),
    (70, "SCHEDULE_RELEASED", _INFO, "a time-tagged command was released"),
    (71, "SCHEDULE_DISCARDED", _LOW, "a time-tagged command was discarded"),
    (80, "TABLE_LOADED", _INFO, "a table was staged"),
    (81, "TABLE_VALIDATED", _INFO, "a staged table is valid"),
    (82, "TABLE_INVALID", _MEDIUM, "a staged table is not valid"),
    (83, "TABLE_ACTIVATED", _INFO, "a table was activated"),
    (84, "TABLE_ABORTED", _INFO, "a staged table was dropped"),
    (85, "TABLE_CORRUPT", _HIGH, "a stored table cannot be read; the one before it is used"),
    (86, "TABLE_DUMPED", _INFO, "a table was written to a file"),
    (90, "PARAMETERS_SET", _INFO, "on-board parameters were set"),
    (91, "PARAMETERS_CORRUPT", _HIGH, "stored parameters cannot be read; defaults are used"),
    (100, "LIMIT_VIOLATED", _MEDIUM, "a monitored value is outside its limits"),
    (101, "LIMIT_RECOVERED", _INFO, "a monitored value is within its limits again"),
    (102, "LIMIT_ACTION", _HIGH, "a monitor has taken its action"),
    (110, "STATE_SAVED", _INFO, "the estimator's state was saved"),
    (111, "STATE_RESTORED", _INFO, "the estimator's state was restored"),
    (112, "STATE_REFUSED", _MEDIUM, "a saved state does not fit; nothing restored"),
    (113, "CHECKPOINT_REFUSED", _MEDIUM, "a checkpoint is not used"),
    (114, "CHECKPOINT_FAILED", _MEDIUM, "a checkpoint cannot be written"),
    (120, "FILE_SENT", _INFO, "a file went down"),
    (121, "FILE_RECEIVED", _INFO, "a file came up"),
    (122, "FILE_FAILED", _MEDIUM, "a file transfer failed"),
    (OTHER_ID, "OTHER", _LOW, "an event without a number; its code is in the text"),
)

EVENTS = tuple(
    EventDefinition(id=number, code=code, severity=severity, doc=doc)
    for number, code, severity, doc in _TABLE
)
EVENT = Enumeration(name="event", labels={0: "NONE"} | {event.id: event.code for event in EVENTS})
