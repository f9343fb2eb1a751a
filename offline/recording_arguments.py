"""Argument parsers of the commands that read or write recordings and results."""

import argparse
from math import inf
from pathlib import Path

from fsw.daemon_arguments import Command, Commands, overlay_argument
from offline.out_argument import out_argument

INSTEAD = "instead of the configuration's"
ONLINE = ("mrnea", "rda", "cm", "fused")


def replay_arguments(commands: Commands, command: Command) -> None:
    """Add the parser of `fsw replay`."""
    replay = commands.add_parser("replay", help="identify from a recording, as fast as it goes")
    _recorded_arguments(replay)
    _part_arguments(replay)
    replay.add_argument("--json", action="store_true", help="print the result as one JSON object")
    replay.set_defaults(command=command)


def identify_arguments(commands: Commands, command: Command) -> None:
    """Add the parser of `fsw identify`."""
    identify = commands.add_parser("identify", help="identify from a recording by a batch method")
    identify.add_argument("recording", type=Path, metavar="RECORDING")
    identify.add_argument(
        "--config", type=Path, metavar="CONFIG", help="instead of the one in the recording"
    )
    overlay_argument(identify)
    identify.add_argument("--method", choices=(*ONLINE, "ce"), default="fused")
    identify.add_argument(
        "--unknown",
        metavar="BODIES",
        help="base, target, both or names with commas between; default: as the configuration says",
    )
    _part_arguments(identify)
    identify.add_argument(
        "--holdout", type=float, metavar="SHARE", help="share of windows to hold out and predict"
    )
    identify.add_argument(
        "--reference", type=Path, metavar="EMPTY", help="recording without the unknown bodies"
    )
    out_argument(identify, "JSON", "file of the result, with every figure of --json")
    out_argument(identify, "HTML", "a page of the result, CSV and PNG beside it", "--report")
    identify.add_argument("--json", action="store_true", help="print the result as one JSON object")
    identify.set_defaults(command=command)


def import_arguments(commands: Commands, command: Command) -> None:
    """Add the parser of `fsw import`."""
    parser = commands.add_parser(
        "import",
        help="make a recording from logs of other tools",
        description="Write a recording from logs of other tools; docs/import.md.",
        epilog="examples: fsw import --can arm=candump.log --serial imu=imu.csv "
        "--config robot.yaml --out recording.mcap; "
        "fsw import arm.csv --map mapping.yaml --config robot.yaml --out recording.mcap",
    )
    parser.add_argument(
        "file",
        type=Path,
        metavar="FILE",
        nargs="?",
        help="table, .npz or ROS 2 bag; with --map",
    )
    parser.add_argument("--map", type=Path, metavar="YAML", help="what the columns of FILE are")
    parser.add_argument("--config", type=Path, metavar="CONFIG", required=True)
    overlay_argument(parser)
    out_argument(parser, "RECORDING", "new MCAP; required")
    parser.add_argument(
        "--can",
        action="append",
        default=[],
        metavar="BUS=FILE[:CHANNEL]",
        help="of a bus: candump, .blf, .asc, .trc, BUSMASTER",
    )
    parser.add_argument(
        "--serial",
        action="append",
        default=[],
        metavar="DEVICE=FILE",
        help="of imu or star_tracker: CSV or JSON lines of stamp_s and hex",
    )
    parser.add_argument(
        "--shift",
        action="append",
        default=[],
        metavar="NAME=S",
        help="added to the stamps of a bus or device",
    )
    parser.set_defaults(command=command)


def report_arguments(commands: Commands, command: Command) -> None:
    """Add the parser of `fsw report`."""
    report = commands.add_parser(
        "report",
        help="a recording, or what a running daemon has recorded so far, as one HTML page",
        epilog="examples: fsw report recording.mcap --png; fsw report live --config robot.yaml",
    )
    _recorded_arguments(report, "RECORDING|live")
    out_argument(report, "HTML", "instead of RECORDING's name with .html, made again each time")
    report.add_argument("--csv", action="store_true", help="tables beside it")
    report.add_argument("--png", action="store_true", help="a picture beside it")
    report.add_argument("--parquet", action="store_true", help="tables as Parquet beside it")
    report.add_argument(
        "--mcap", action="store_true", help="the estimate for Foxglove and PlotJuggler beside it"
    )
    _part_arguments(report)
    report.set_defaults(command=command)


def check_arguments(commands: Commands, command: Command) -> None:
    """Add the parser of `fsw check`."""
    check = commands.add_parser("check", help="validate everything; touch no device")
    check.add_argument("config", type=Path, metavar="CONFIG")
    overlay_argument(check)
    check.add_argument(
        "other",
        type=Path,
        nargs="?",
        metavar="RECORDING|LOG|PLAN",
        help="judge the one by the other; what a motion (YAML) would show",
    )
    check.set_defaults(command=command)


def calibrate_arguments(commands: Commands, command: Command) -> None:
    """Add the parser of `fsw calibrate`."""
    calibrate = commands.add_parser(
        "calibrate",
        help="offsets, biases and mounting from a recording, as a configuration overlay",
        description="rest: torque offsets and biases of the inertial unit while nothing moves. "
        "motion: the same with torque scales, mounting and lever arm of the inertial unit, and the "
        "delays of gyro, accelerometer and star tracker against the joints; scales and axes of the "
        "gyro where the configuration puts them in doubt.",
        epilog="example: fsw calibrate rest recording.mcap --config robot.yaml --to 60 "
        "--out calibration.yaml; then fsw identify other.mcap --config robot.yaml "
        "--overlay calibration.yaml",
    )
    calibrate.add_argument("mode", choices=("rest", "motion"))
    calibrate.add_argument(
        "recording",
        type=Path,
        nargs="+",
        metavar="RECORDING",
        help="one; of a body without joints in motion several, as of one flight",
    )
    calibrate.add_argument("--config", type=Path, metavar="CONFIG", required=True)
    overlay_argument(calibrate)
    _span_arguments(calibrate)
    out_argument(calibrate, "FILE", "write the overlay there")
    calibrate.add_argument("--json", action="store_true", help="print the figures as JSON")
    calibrate.set_defaults(command=command)


def export_arguments(commands: Commands, command: Command) -> None:
    """Add the parser of `fsw export`."""
    export = commands.add_parser(
        "export",
        help="an identified body for other tools; `export ros2`: the message package; "
        "`export dictionary`: the telemetry dictionary for ground tools",
    )
    export.add_argument("result", type=Path, metavar="RESULT", help="of fsw identify --json")
    kinds = ("urdf", "sdf", "mjcf", "json", "csv", "parquet", "ros2")
    export.add_argument("--format", choices=kinds, default="json", help="json")
    export.add_argument("--body", metavar="NAME", help="needed where there are two")
    export.add_argument("--frame", metavar="NAME", help="what the body's frame is called elsewhere")
    out_argument(export, "PATH", "instead of standard output")
    export.set_defaults(command=command)


def view_arguments(commands: Commands, command: Command) -> None:
    """Add the parser of `fsw view`."""
    view = commands.add_parser(
        "view",
        help="a recording or a plan in motion, as one HTML page",
        epilog="examples: fsw view recording.mcap; fsw view plan.yaml --config robot.yaml",
    )
    view.add_argument("source", type=Path, metavar="RECORDING|PLAN")
    view.add_argument(
        "--config", type=Path, metavar="CONFIG", help="instead of the one in the recording"
    )
    overlay_argument(view)
    out_argument(view, "HTML", "instead of its name with _motion.html, made again each time")
    view.add_argument(
        "--truth", type=Path, metavar="JSON", help="true bodies, such as result.json of hil run"
    )
    view.set_defaults(command=command)


def _recorded_arguments(parser: argparse.ArgumentParser, metavar: str = "RECORDING") -> None:
    parser.add_argument("recording", type=Path, metavar=metavar)
    parser.add_argument(
        "--config", type=Path, metavar="CONFIG", help="instead of the one in the recording"
    )
    overlay_argument(parser)
    parser.add_argument("--method", choices=ONLINE, help=INSTEAD)


def _part_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--weighting` (for method mrnea), `--from` and `--to`."""
    parser.add_argument("--weighting", choices=("ols", "wls", "eiv"), help=f"{INSTEAD}; mrnea")
    _span_arguments(parser)


def _span_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--from` and `--to`, which select a part of the recording."""
    parser.add_argument(
        "--from", dest="from_s", type=float, default=0.0, metavar="S", help="from the start, 0"
    )
    parser.add_argument(
        "--to", dest="to_s", type=float, default=inf, metavar="S", help="from the start, its end"
    )
