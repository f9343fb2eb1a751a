"""Fields of the housekeeping sets 1 to 8 and of the science set, which service 3 reports."""

from fsw.config.telemetry import BUS_SLOTS, JOINT_SLOTS
from fsw.telemetry.dictionary.codes import (
    APID_ESTIMATOR,
    APID_SCIENCE,
    JOB_STATE,
    METHOD,
    MODE,
    REASON,
    RESET_CAUSE,
    RESULT_STATUS,
    SECURITY,
    TABLE_STATE,
    UNKNOWN,
    YES_NO,
    Health,
    Table,
)
from fsw.telemetry.dictionary.fields import (
    RED,
    YELLOW,
    ZERO,
    choice,
    counters,
    error,
    number,
    text,
)
from fsw.telemetry.dictionary.types import Enumeration, Field, Limits, Packet, Type

SCIENCE_SID = 20
AXES = ("x", "y", "z")
INERTIA = ("xx", "xy", "xz", "yy", "yz", "zz")
TASKS = ("drain", "hand_over")  # tasks of the loop
DELAYS = {"sampled": "frame to sample", "published": "window closed to estimate published"}
REASONS = ("sync", "length", "crc", "sequence", "range", "status", "node", "stale")
# estimation coordinates of one body: mass, mass x centre of mass, inertia about the frame's origin
COORDINATES = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
COORDINATE_UNITS = ("kg", "kg.m", "kg.m", "kg.m") + ("kg.m2",) * 6
STATES = tuple(f"{body}_{name}" for body in ("base", "target") for name in COORDINATES)
STATE_UNITS = COORDINATE_UNITS * 2
PATH_BYTES = 96
TEXT_BYTES = 120
SILENT_LEAST_S = 2.0  # least time without a summary after which the loop counts as silent


def _times(prefix: str, doc: str) -> tuple[Field, ...]:
    return tuple(
        number(f"{prefix}_{kind}_us", Type.F32, "us", f"{doc}, {kind}")
        for kind in ("last", "mean", "max")
    )


def _body(prefix: str, doc: str) -> tuple[Field, ...]:
    """Return a body's parameters and 1 sigma; the inertia is about the centre of mass."""
    values, sigmas = [], []
    for name, unit in (
        ("mass_kg", "kg"),
        *((f"com_{axis}_m", "m") for axis in AXES),
        *((f"inertia_{pair}_kg_m2", "kg.m2") for pair in INERTIA),
    ):
        values.append(number(f"{prefix}_{name}", Type.F64, unit, doc))
        sigmas.append(number(f"{prefix}_sigma_{name}", Type.F64, unit, f"{doc}, 1 sigma"))
    return (
        choice(f"{prefix}_present", YES_NO, "whether this body is among the unknowns"),
        choice(
            f"{prefix}_consistent",
            YES_NO,
            "whether the estimate was physically possible",
            NO=YELLOW,
        ),
        *values,
        *sigmas,
    )


def _vector(name: str, unit: str, suffix: str, doc: str) -> tuple[Field, ...]:
    return tuple(number(f"{name}_{axis}_{suffix}", Type.F64, unit, doc) for axis in AXES)


def _device(name: str) -> tuple[Field, ...]:
    return (
        choice(f"{name}_up", YES_NO, "link open"),
        number(f"{name}_losses", Type.U16, doc="times the link was lost"),
        *counters(
            *(f"{name}_{word}" for word in ("received", "accepted", "lost", "late", "rejected")),
            *(f"{name}_reject_{reason}" for reason in REASONS),
        ),
    )


SLIDING = "the second unit where joints[].kind is prismatic"


def _motor(joint: int) -> tuple[Field, ...]:
    name = f"joint_{joint}"
    return (
        choice(f"{name}_motor_present", YES_NO, f"whether joint {joint} has sent a TPDO2"),
        number(f"{name}_velocity", Type.F32, "rad/s or m/s", f"of its newest TPDO2; {SLIDING}"),
        number(f"{name}_motor_torque_ratio", Type.F32, doc="motor torque over rated torque"),
        number(f"{name}_temperature_degc", Type.F32, "degC", "of its newest TPDO2"),
    )


REASONS_DOC = "every reason why not valid; bits as the values of `reason`: " + ", ".join(
    f"{bit} {label}" for bit, label in REASON.labels.items() if 0 < bit < 16
)
HEALTH_DOC = "latched health word, 0 healthy; bits: " + ", ".join(
    f"{bit.value} {bit.severity.lower()} {bit.name.lower().replace('_', ' ')}" for bit in Health
)
HEALTH_FIELDS = (
    choice("mode", MODE, SAFE=YELLOW),
    number("health", Type.U32, doc=HEALTH_DOC, limits=ZERO),
    number(
        "health_now", Type.U32, doc="the same bits, as of this packet, not latched", limits=ZERO
    ),
    number("boot_count", Type.U32, doc="starts of the daemon on this state directory"),
    choice("reset_cause", RESET_CAUSE, CRASH=YELLOW),
    number("met_s", Type.F64, "s", "mission elapsed time: the daemon's monotonic clock"),
    number("config_crc32", Type.U32),
    number("dictionary_crc32", Type.U32),
    *counters("ticks", "slips"),
    number("max_late_us", Type.F32, "us", "latest wake of the loop"),
    *_times("work", "time of all tasks of one tick"),
    *(part for task in TASKS for part in _times(task, f"task {task}")),
    *(part for name, doc in DELAYS.items() for part in _times(name, doc)),
    number(
        "summary_age_s",
        Type.F32,
        "s",
        "age of the loop's newest summary",
        Limits(yellow_high=SILENT_LEAST_S, red_high=5 * SILENT_LEAST_S),
    ),
    *counters("ring_records"),
    *counters("ring_dropped", limits=ZERO),
    *counters(
        "windows_closed",
        "windows_unusable",
        "windows_outliers",
        "windows_early",
        "windows_future",
        "windows_overflow",
        "tc_accepted",
        "tc_rejected",
        "tc_completed",
        "tc_failed",
        "events",
        "events_suppressed",
    ),
    error("last_error", "of the last rejected command"),
    number("command_loss_left_s", Type.F32, "s", "until the command-loss reaction; -1: off"),
)

ESTIMATE_FIELDS = (
    number("estimate_time_s", Type.F64, "s", "mission elapsed time of the newest data used"),
    number("age_s", Type.F32, "s", "time since then"),
    choice("valid", YES_NO, NO=YELLOW),
    choice(
        "reason",
        REASON,
        "the most severe reason why not valid",
        MODEL_MISMATCH=RED,
        PRIOR_CONFLICT=YELLOW,
        NOT_CONSISTENT=RED,
    ),
    number("reasons", Type.U16, doc=REASONS_DOC),
    choice("method", METHOD),
    choice("unknown", UNKNOWN),
    *counters("blocks", "gated", "changes", "ignored"),
    number("nis", Type.F64, doc="normalised innovation squared of the newest window"),
    number("nis_dof", Type.U16),
    number(
        "noise_ratio",
        Type.F64,
        doc="residual noise over the declared noise",
        limits=Limits(yellow_high=1.5, red_high=3.0),
    ),
    number("innovation_lag1", Type.F64, doc="correlation of successive innovations"),
    number("innovation_lag1_bound", Type.F64),
    number(
        "condition_number",
        Type.F64,
        doc="excitation: of the scaled information",
        limits=Limits(yellow_high=1e8),
    ),
    number("information_gained_nats", Type.F64),
    *_body("base", "base, in B"),
    *_body("target", "target, in E"),
    *_body("whole", "everything together as posed, in B"),
    *_vector("acc_bias", "m/s2", "m_s2", "estimated accelerometer bias, base axes"),
    *_vector("gyro_bias", "rad/s", "rad_s", "estimated gyro bias, base axes"),
    *(
        number(f"torque_offset_{k}", Type.F64, "N.m or N", f"estimated, joint {k}; {SLIDING}")
        for k in range(1, JOINT_SLOTS + 1)
    ),
    *(
        part
        for k in range(1, JOINT_SLOTS + 1)
        for part in (
            number(
                f"residual_torque_{k}",
                Type.F32,
                "N.m or N",
                f"rms over the newest window of measured less predicted torque of joint {k}; "
                + SLIDING,
            ),
            number(
                f"residual_torque_{k}_ratio",
                Type.F32,
                doc=f"the same of joint {k} over what the declared noise explains; about 1 is good",
            ),
        )
    ),
)

COVARIANCE_FIELDS = (
    number("estimate_time_s", Type.F64, "s"),
    choice("base_present", YES_NO),
    choice("target_present", YES_NO),
    *(
        number(
            f"cov_{STATES[row]}_{STATES[column]}",
            Type.F64,
            f"{STATE_UNITS[row]}.{STATE_UNITS[column]}",
        )
        for row in range(len(STATES))
        for column in range(row + 1)
    ),
)

DEVICE_FIELDS = (
    *(part for k in range(1, BUS_SLOTS + 1) for part in _device(f"bus{k}")),
    *_device("imu"),
    *_device("star_tracker"),
    *(part for k in range(1, JOINT_SLOTS + 1) for part in _motor(k)),
)

JOB_FIELDS = (
    number("job_id", Type.U32),
    choice("state", JOB_STATE, FAILED=YELLOW, ABORTED=YELLOW),
    number("progress_ratio", Type.F32),
    choice("method", METHOD),
    choice("unknown", UNKNOWN),
    choice(
        "result_status",
        RESULT_STATUS,
        NOT_CONVERGED=YELLOW,
        INSUFFICIENT_EXCITATION=YELLOW,
        MODEL_MISMATCH=RED,
        TOO_FEW_BLOCKS=YELLOW,
        PRIOR_CONFLICT=YELLOW,
        NOT_CONSISTENT=RED,
    ),
    number("result_reasons", Type.U16, doc=REASONS_DOC),
    number("cost", Type.F64, doc="sum of squared whitened residuals"),
    number("condition_number", Type.F64),
    number("duration_s", Type.F64, "s", "of the data used"),
    *_body("base", "base, in B"),
    *_body("target", "target, in E"),
    text("text", TEXT_BYTES, "what it does, or why it failed"),
)

TABLE_FIELDS = tuple(
    part
    for table in Table
    for part in (
        choice(f"{table.name.lower()}_state", TABLE_STATE),
        number(f"{table.name.lower()}_generation", Type.U16, doc="activations so far"),
        number(f"{table.name.lower()}_active_crc32", Type.U32),
        number(f"{table.name.lower()}_staged_crc32", Type.U32),
        number(f"{table.name.lower()}_staged_bytes", Type.U32, "B"),
        error(f"{table.name.lower()}_error"),
    )
)

RECORDER_FIELDS = (
    choice("recording", YES_NO),
    *counters("failed_messages", "dropped_messages", limits=ZERO),
    *counters("recordings"),
    number("file_bytes", Type.U64, "B"),
    number(
        "disk_free_bytes",
        Type.U64,
        "B",
        "of the recording's disk; before the first recording, of the state directory's",
        Limits(red_low=1e8, yellow_low=1e9),
    ),
    text("file", PATH_BYTES, "the recording being written, or the last one"),
)

LINK_FIELDS = (
    number("met_s", Type.F64, "s"),
    number("boot_count", Type.U32),
    choice("tc_security", SECURITY),
    number("clients", Type.U8),
    *counters("tm_packets"),
    *counters("tm_dropped", limits=ZERO),
    *counters(
        "tc_packets",
        "tc_garbage_bytes",
        "tc_resyncs",
        "udp_packets",
        "udp_dropped",
    ),
    number("tm_bytes", Type.U64, "B"),
    number("tc_bytes", Type.U64, "B"),
    *counters("sdls_accepted"),
    *counters("sdls_failed", "sdls_replayed", "tc_not_authorised", limits=ZERO),
    *counters(
        "files_sent",
        "files_received",
        "files_failed",
        "pdus_sent",
        "pdus_received",
    ),
    choice("schedule_enabled", YES_NO),
    number("schedule_entries", Type.U16),
    *counters("schedule_released", "schedule_discarded"),
)

SCIENCE_FIELDS = (
    number("joint_time_s", Type.F64, "s", "mission elapsed time of validity, newest joint sample"),
    number("gyro_time_s", Type.F64, "s"),
    number("acc_time_s", Type.F64, "s"),
    number("attitude_time_s", Type.F64, "s"),
    number(
        "fresh",
        Type.U16,
        doc="bits: 0 gyro, 1 accelerometer, 2 attitude, 8 and up joints 1 and up; set: a sample "
        "came since the last science packet",
    ),
    *(
        part
        for k in range(1, JOINT_SLOTS + 1)
        for part in (
            number(f"joint_{k}_position", Type.F64, "rad or m", SLIDING),
            number(f"joint_{k}_torque", Type.F64, "N.m or N", SLIDING),
        )
    ),
    *_vector("gyro", "rad/s", "rad_s", "sensor axes"),
    *_vector("specific_force", "m/s2", "m_s2", "sensor axes"),
    *(number(f"attitude_{part}", Type.F64, doc="q_NB") for part in ("x", "y", "z", "w")),
    number("nis", Type.F64, doc="normalised innovation squared of the newest window"),
)


def _set(sid: int, name: str, doc: str, fields: tuple[Field, ...], apid: int) -> Packet:
    return Packet(
        name=name,
        apid=apid,
        service=3,
        subtype=25,
        doc=doc,
        fields=(number("sid", Type.U16, doc="housekeeping set"), *fields),
        match=(("sid", sid),),
    )


HOUSEKEEPING = tuple(
    _set(sid, name, doc, fields, APID_ESTIMATOR)
    for sid, name, doc, fields in (
        (1, "health", "Scheduler, health, counters", HEALTH_FIELDS),
        (2, "estimate", "The online estimate with its 1 sigma", ESTIMATE_FIELDS),
        (
            3,
            "covariance",
            "Covariance of the bodies' estimation coordinates, lower triangle; 0 "
            "where a body is not among the unknowns",
            COVARIANCE_FIELDS,
        ),
        (4, "devices", "Buses and drivers, in the order of the configuration", DEVICE_FIELDS),
        (5, "batch", "The batch job and its result", JOB_FIELDS),
        (6, "tables", "State of the tables", TABLE_FIELDS),
        (7, "recorder", "The recorder", RECORDER_FIELDS),
        (8, "link", "Time, link, files, schedule", LINK_FIELDS),
    )
)
SCIENCE = _set(
    SCIENCE_SID, "science", "Newest sample of every channel", SCIENCE_FIELDS, APID_SCIENCE
)
SETS = (*HOUSEKEEPING, SCIENCE)
SID = Enumeration(name="sid", labels={dict(item.match)["sid"]: item.name.upper() for item in SETS})
SET_NAMES = {dict(packet.match)["sid"]: packet.name for packet in HOUSEKEEPING}
