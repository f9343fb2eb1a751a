"""The arguments of `hil calibration`; no import of what flies."""

import argparse

from hil.options import add_seeds, add_several

COMMAND = "calibration"
HELP = "fsw calibrate against wrong sensors"
EXAMPLE = "hil calibration --scenario bench_target --count 20 --out runs/calibration"
FUNCTION = "evidence.calibration.command:run"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    scenarios = ("target_leo", "table_target", "bench_target")
    add_several(parser, "--scenario", scenarios, "this one")
    add_seeds(parser, 20, "object")
