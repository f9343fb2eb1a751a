"""The arguments of `hil campaign`; no import of what flies."""

import argparse
from pathlib import Path

from hil.options import count

COMMAND = "campaign"
HELP = "Monte Carlo over what a YAML file names"
EXAMPLE = "hil campaign evidence/campaign/examples/target.yaml --out runs/campaign"
FUNCTION = "evidence.campaign.command:campaign"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("path", type=Path, metavar="CAMPAIGN.yaml")
    parser.add_argument("--out", type=Path, metavar="DIR", help="results; resumed if there")
    parser.add_argument("--workers", type=count, default=2, metavar="N", help="processes, 2")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster, instead")
