"""The arguments of `hil mistakes`; no import of what flies."""

import argparse

from hil.options import seed

COMMAND = "mistakes"
HELP = "mistakes of configuration: valid and wrong?"
EXAMPLE = "hil mistakes --case target --only 'prior wrong and tight'"
FUNCTION = "evidence.mistakes.command:run_all"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    cases = "target, base, both, or bench_target (clamped, under gravity); all"
    parser.add_argument("--case", action="append", default=[], help=cases)
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help="this mistake")
    parser.add_argument("--seed", type=seed, default=0, metavar="K", help="of priors and noise")
    parser.add_argument(
        "--exact", action="store_true", help="arm and calibration declared as exact, not in doubt"
    )
    parser.add_argument("--robot", default="", metavar="FILE", help="a scenario of your own robot")
    parser.add_argument("--json", action="store_true", dest="as_json", help="print one JSON list")
    parser.add_argument(
        "--recording", action="store_true", help="also import, check and identify a recording"
    )
