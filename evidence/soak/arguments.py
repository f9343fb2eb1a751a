"""The arguments of `hil soak`; no import of what flies."""

import argparse
from pathlib import Path

from hil.options import count, seed

COMMAND = "soak"
HELP = "hours in virtual time under random faults"
EXAMPLE = "hil soak --hours 2 --rate 50 --imu-rate 125 --out runs/soak"
FUNCTION = "evidence.soak.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--hours", type=float, default=2.0, metavar="H", help="virtual, 2")
    parser.add_argument("--rate", type=float, default=500.0, metavar="HZ", help="bus and loop, 500")
    parser.add_argument("--imu-rate", type=int, default=500, metavar="HZ", help="500")
    parser.add_argument("--seed", type=seed, default=0, metavar="K", help="fixes every bit")
    parser.add_argument("--jobs", type=count, default=1, metavar="N", help="quarters at a time, 1")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="resumed from there")
