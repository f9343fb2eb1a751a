"""Argument parsers of the commands for the daemon and its computer: run, ctl, install, bench."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"  # noqa: SLF001
Command = Callable[[argparse.Namespace], int]


def run_arguments(commands: Commands, command: Command) -> None:
    """Add the parser of `fsw run`."""
    run = commands.add_parser("run", help="identify from live devices until Ctrl-C or SIGTERM")
    run.add_argument("config", type=Path, metavar="CONFIG")
    overlay_argument(run)
    run.add_argument(
        "--cold", action="store_true", help="start from the prior, ignoring checkpoints"
    )
    run.set_defaults(command=command)


def ctl_arguments(commands: Commands, command: Command) -> None:
    """Add the parser of `fsw ctl`."""
    ctl = commands.add_parser("ctl", help="command a running daemon over its local socket")
    ctl.add_argument("config", type=Path, metavar="CONFIG", help="of the running daemon")
    overlay_argument(ctl)
    ctl.add_argument("name", metavar="COMMAND", help="status, reset, run-batch, adopt ...")
    ctl.add_argument("arguments", nargs="*", metavar="KEY=VALUE")
    ctl.set_defaults(command=command)


def install_arguments(commands: Commands, command: Command) -> None:
    """Add the parser of `fsw install-service`."""
    install = commands.add_parser("install-service", help="write a systemd unit for `fsw run`")
    install.add_argument("config", type=Path, metavar="CONFIG")
    overlay_argument(install)
    install.add_argument("--user", default="fsw", help="user that runs it, fsw; not root")
    install.add_argument(
        "--directory", type=Path, default=Path("/etc/systemd/system"), help="where units are"
    )
    install.set_defaults(command=command)


def bench_arguments(commands: Commands, command: Command) -> None:
    """Add the parser of `fsw bench`."""
    bench = commands.add_parser("bench", help="measure timer, buses and lines of this machine")
    bench.add_argument("--rounds", type=int, default=5, metavar="N")
    bench.add_argument("--seconds", type=float, default=5.0, help="length of each measurement")
    bench.add_argument(
        "--frame-rate", type=float, default=8000.0, metavar="HZ", help="1 Mbit/s is full at 8000"
    )
    bench.add_argument("--priority", type=int, default=0, help="SCHED_FIFO of the timer's part")
    bench.add_argument("--json", action="store_true", help="print the result as one JSON object")
    bench.set_defaults(command=command)


def overlay_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--overlay`: files that change keys of the configuration."""
    parser.add_argument(
        "--overlay",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="some keys of the configuration, such as `fsw calibrate` writes; may be repeated",
    )
