"""The arguments of `hil lies`, and the names it knows; no import of what flies."""

import argparse

from hil.options import add_drawn, add_resumable, count

SENSORS = ("torque", "encoder", "gyro", "accelerometer", "tracker")
KINDS = ("gain", "zero", "drift", "delay")
EXACT, DEFAULT = "exact", "default"  # doubts of the sensors


COMMAND = "lies"
HELP = "sensors that lie slowly: valid and wrong?"
EXAMPLE = "hil lies --only exact --every 10 --out runs/lies"
FUNCTION = "hil.evidence.lies.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        choices=(*SENSORS, *KINDS, EXACT, DEFAULT),
        help="lies of this sensor, kind or doubt; may be repeated",
    )
    parser.add_argument(
        "--every", type=count, default=1, metavar="N", help="one of N lies, evenly chosen; all 200"
    )
    add_drawn(parser)
    add_resumable(parser, "lies")
