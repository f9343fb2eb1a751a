"""The arguments of `hil bench`; no import of what flies."""

import argparse
from pathlib import Path

from hil.options import add_several, count

COMMAND = "bench"
HELP = "the whole daemon in real time, alone and loaded"
EXAMPLE = "hil bench target_leo --rounds 3 --only alone"
FUNCTION = "evidence.speed.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("scenario", nargs="?", default="target_leo", metavar="SCENARIO")
    parser.add_argument(
        "--rounds", type=count, default=5, metavar="N", help="of every condition, 5"
    )
    parser.add_argument("--seconds", type=float, default=30.0, metavar="S", help="of a run, 30")
    add_several(parser, "--only", ("alone", "hog", "batch", "clients"), "this condition")
    parser.add_argument(
        "--bus",
        choices=("udp_multicast", "udp_frames"),
        default="udp_multicast",
        help="udp_frames: frames as sockets of SocketCAN hand them over",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep the runs and resume")
    parser.add_argument("--json", action="store_true", dest="as_json", help="print one JSON object")
