"""Sensors that lie slowly, and whether an estimate loses its validity before it is wrong."""

from evidence.declaration import DRAWN, declared, option, resumable, several
from hil.options import count

SENSORS = ("torque", "encoder", "gyro", "accelerometer", "tracker")
KINDS = ("gain", "zero", "drift", "delay")
EXACT, DEFAULT = "exact", "default"  # doubts of the sensors

COMMAND = declared(
    "lies",
    "sensors that lie slowly: valid and wrong?",
    "hil lies --only exact --every 10 --out runs/lies",
    "evidence.lies.command:run",
    several("--only", (*SENSORS, *KINDS, EXACT, DEFAULT), "lies of this sensor, kind or doubt"),
    option(
        "--every", type=count, default=1, metavar="N", help="one of N lies, evenly chosen; all 200"
    ),
    DRAWN,
    *resumable("lies"),
)
