"""On-board parameters of service 20, and the numbers of telemetered values for monitors."""

from fsw.telemetry.dictionary.housekeeping import HOUSEKEEPING
from fsw.telemetry.dictionary.types import Enumeration, Parameter, Type

QUIET = ("SAFE", "STANDBY")  # while the online estimator is paused

PARAMETERS = (
    Parameter(
        id=1,
        name="command_loss_time_s",
        type=Type.F32,
        default=0.0,
        minimum=0.0,
        maximum=1e7,
        unit="s",
        doc="without a telecommand for so long the daemon goes to SAFE; 0: never",
    ),
    Parameter(
        id=2,
        name="event_throttle_count",
        type=Type.U16,
        default=10,
        minimum=1,
        maximum=1000,
        doc="events of one number that go out within the throttle period",
    ),
    Parameter(
        id=3,
        name="event_throttle_period_s",
        type=Type.F32,
        default=10.0,
        minimum=0.1,
        maximum=3600.0,
        unit="s",
        doc="after which the count begins again",
    ),
    Parameter(
        id=4,
        name="schedule_margin_s",
        type=Type.F32,
        default=0.0,
        minimum=0.0,
        maximum=3600.0,
        unit="s",
        doc="a time-tagged command must lie at least so far ahead when it is inserted",
    ),
    Parameter(
        id=5,
        name="time_report_exponent",
        type=Type.U8,
        default=4,
        minimum=0,
        maximum=8,
        doc="a time packet every 2^this housekeeping seconds",
    ),
    Parameter(
        id=6,
        name="batch_last_s",
        type=Type.F32,
        default=0.0,
        minimum=0.0,
        maximum=1e6,
        unit="s",
        doc="window of a batch job that names none; 0: everything stored",
    ),
    Parameter(
        id=10,
        name="gate_probability",
        type=Type.F64,
        default=1e-6,
        minimum=1e-12,
        maximum=0.099,
        doc="estimator.gate_probability; set, it stands above the configuration",
        accepted_in=QUIET,
    ),
    Parameter(
        id=11,
        name="condition_limit",
        type=Type.F64,
        default=1e8,
        minimum=1.0,
        maximum=1e15,
        doc="estimator.condition_limit",
        accepted_in=QUIET,
    ),
    Parameter(
        id=12,
        name="forgetting_time_s",
        type=Type.F64,
        default=0.0,
        minimum=0.0,
        maximum=1e9,
        unit="s",
        doc="estimator.forgetting_time_s; 0: nothing is forgotten",
        accepted_in=QUIET,
    ),
    Parameter(
        id=13,
        name="settle_blocks",
        type=Type.U32,
        default=25,
        minimum=1,
        maximum=1_000_000,
        doc="estimator.settle_blocks",
        accepted_in=QUIET,
    ),
)
PARAMETER = Enumeration(name="parameter", labels={item.id: item.name for item in PARAMETERS})

_NUMERIC = frozenset(Type) - {Type.TEXT, Type.BYTES}


def value_ids() -> dict[int, tuple[str, str]]:
    """Return number -> (packet, field) of values for monitors: 1000 x set + place in the set."""
    found = {}
    for packet in HOUSEKEEPING:
        sid = dict(packet.match)["sid"]
        if packet.name == "covariance":
            continue  # there is no use in monitors of single matrix elements
        for place, item in enumerate(packet.fields):
            if place and item.type in _NUMERIC:
                found[1000 * sid + place] = (packet.name, item.name)
    return found


VALUE = Enumeration(
    name="value",
    labels={number: f"{packet}.{name}" for number, (packet, name) in value_ids().items()},
)
