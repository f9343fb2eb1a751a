"""The arguments of `hil lies`, and the names it knows; no import of what flies."""

import argparse

from hil.options import add_resumable, count, seed

SENSORS = ("torque", "encoder", "gyro", "accelerometer", "tracker")
KINDS = ("gain", "zero", "drift", "delay")
EXACT, DEFAULT = "exact", "default"  # doubts of the sensors


def add_parser(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the command."""
    lies = commands.add_parser("lies", help="sensors that lie slowly: valid and wrong?")
    lies.add_argument(
        "--only",
        action="append",
        default=[],
        choices=(*SENSORS, *KINDS, EXACT, DEFAULT),
        help="lies of this sensor, kind or doubt; may be repeated",
    )
    lies.add_argument(
        "--every", type=count, default=1, metavar="N", help="one of N lies, evenly chosen; all 200"
    )
    lies.add_argument(
        "--seed",
        type=seed,
        metavar="K",
        help="for development, below 1000; default: drawn from the commit's hash",
    )
    add_resumable(lies, "lies")
    lies.set_defaults(function="hil.evidence.lies.command:run")
