"""Arguments of `fsw excite`, in a module that does not import the planner (slow to load)."""

import argparse
from pathlib import Path

from offline.out_argument import out_argument

CRITERIA = ("sigma", "d", "a", "e", "cond", "gamma")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `fsw excite` to its parser."""
    parser.add_argument("config", type=Path, metavar="CONFIG")
    parser.add_argument("--unknown", choices=("base", "target", "both"))
    parser.add_argument("--limits", type=Path, metavar="YAML", help="the motion's limits")
    out_argument(parser, "YAML", "file for the trajectory")
    parser.set_defaults(new=())  # with --evaluate only a picture is written
    parser.add_argument(
        "--evaluate", type=Path, metavar="FILE", help="judge a trajectory (YAML) or a recording"
    )
    parser.add_argument("--criterion", choices=CRITERIA, default="sigma")
    parser.add_argument("--xi1", type=float, default=1.0, help="gamma: weight of the condition")
    parser.add_argument("--xi2", type=float, default=1e4, help="gamma: of 1/sum|tau| [N m s]")
    parser.add_argument("--weight", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--after", type=Path, metavar="JSON", help="result that replaces the prior")
    parser.add_argument("--duration-s", type=float, default=60.0)
    parser.add_argument("--knot-s", type=float, default=2.5, help="time between the spline's knots")
    parser.add_argument("--closed", action="store_true", help="end where it starts: repeatable")
    parser.add_argument("--start-from", type=Path, metavar="YAML", help="a trajectory to improve")
    parser.add_argument("--starts", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1, help="starts computed at a time")
    parser.add_argument("--iterations", type=int, default=40, help="of the solver, per start")
    parser.add_argument("--rate-hz", type=float, default=2.5, help="samples that the solver uses")
    parser.add_argument("--spread", type=float, default=0.0, help="of the prior set, in its sigmas")
    parser.add_argument("--draws", type=int, default=8, help="bodies in the prior set")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--export-rate-hz", type=float, default=20.0)
