"""The arguments of `hil hardware`; no import of what flies."""

import argparse
from pathlib import Path

COMMAND = "hardware"
HELP = "recordings of real arms, fetched if wanted"
EXAMPLE = "hil hardware --data ~/recordings --fetch"
FUNCTION = "evidence.hardware.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--data", type=Path, required=True, metavar="DIR", help="where the recordings lie"
    )
    parser.add_argument("--fetch", action="store_true", help="load what is missing from GitHub")
    parser.add_argument(
        "--repository",
        type=Path,
        action="append",
        default=[],
        dest="repositories",
        metavar="DIR",
        help="with --fetch: a local git repository of the data; may be repeated",
    )
    parser.add_argument(
        "--arm",
        action="append",
        default=[],
        dest="arms",
        metavar="NAME",
        help="this one, such as ur10e; may be repeated; default: all",
    )
    parser.add_argument(
        "--held-out", action="store_true", help="judge also the runs that no choice has used"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep what was imported")
    parser.add_argument("--json", action="store_true", dest="as_json", help="print one JSON list")
    parser.add_argument(
        "--throws",
        action="store_true",
        help="of thrown bodies with a reaction wheel instead; needs orangebox",
    )
