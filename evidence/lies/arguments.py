"""The arguments of `hil lies`, and the names it knows; no import of what flies."""

import argparse

from hil.options import add_drawn, add_resumable, add_several, count

SENSORS = ("torque", "encoder", "gyro", "accelerometer", "tracker")
KINDS = ("gain", "zero", "drift", "delay")
EXACT, DEFAULT = "exact", "default"  # doubts of the sensors


COMMAND = "lies"
HELP = "sensors that lie slowly: valid and wrong?"
EXAMPLE = "hil lies --only exact --every 10 --out runs/lies"
FUNCTION = "evidence.lies.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    every = (*SENSORS, *KINDS, EXACT, DEFAULT)
    add_several(parser, "--only", every, "lies of this sensor, kind or doubt")
    parser.add_argument(
        "--every", type=count, default=1, metavar="N", help="one of N lies, evenly chosen; all 200"
    )
    add_drawn(parser)
    add_resumable(parser, "lies")
