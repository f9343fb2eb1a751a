"""Command line of the flight software, of its planner and of the tools beside it.

Exit codes: 0 done, 1 a device or the estimator failed, 2 the configuration is wrong.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from fsw.daemon_arguments import (
    bench_arguments,
    ctl_arguments,
    install_arguments,
    overlay_argument,
    run_arguments,
)
from fsw.errors import ConfigError, FswError, in_words
from fsw.streams import open_standard_streams
from offline.examples import EXAMPLES
from offline.excite_arguments import add_arguments as excite_arguments
from offline.init.arguments import add_arguments as init_arguments
from offline.out_argument import refuse_existing
from offline.progress import Progress
from offline.recording_arguments import (
    calibrate_arguments,
    check_arguments,
    export_arguments,
    identify_arguments,
    import_arguments,
    replay_arguments,
    report_arguments,
    view_arguments,
)

if TYPE_CHECKING:
    from fsw.config import Config
    from offline.robot import Robot

CONFIG_EXIT = 2
FAILED_EXIT = 1
INTERRUPTED_EXIT = 130  # 128 + SIGINT


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand and return the exit code."""
    open_standard_streams()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # set before numpy loads: one thread
    arguments = parser().parse_args(argv)
    command: Callable[[argparse.Namespace], int] = arguments.command
    try:
        for new in getattr(arguments, "new", ()):
            refuse_existing(arguments, new)
        return command(arguments)
    except BrokenPipeError:  # the reader closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        print("\nfsw: interrupted", file=sys.stderr)
        return INTERRUPTED_EXIT
    except (FswError, ModuleNotFoundError, OSError) as error:
        print(f"fsw: {in_words(error, 'fsw')}", file=sys.stderr)
        return CONFIG_EXIT if isinstance(error, ConfigError | ModuleNotFoundError) else FAILED_EXIT


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands; completion and documentation use it too."""
    program = argparse.ArgumentParser(prog="fsw", description=__doc__)
    release = f"%(prog)s {version('inertia-daemon')}"
    program.add_argument("--version", action="version", version=release)
    commands = program.add_subparsers(required=True, metavar="COMMAND")

    run_arguments(commands, _run)
    replay_arguments(commands, _replay)
    identify_arguments(commands, _identify)
    report_arguments(commands, _report)
    view_arguments(commands, _view)
    import_arguments(commands, _import)
    calibrate_arguments(commands, _calibrate)

    excite = commands.add_parser("excite", help="plan or judge a motion that identifies well")
    excite_arguments(excite)
    overlay_argument(excite)
    excite.set_defaults(command=_excite)

    ctl_arguments(commands, _ctl)
    install_arguments(commands, _install_service)
    _configuration_parsers(commands)
    bench_arguments(commands, _bench)
    for name, example in EXAMPLES.items():
        commands.choices[name].epilog = f"example: {example}"
    return program


def _bench(arguments: argparse.Namespace) -> int:
    from offline.bench import bench

    with Progress("bench") as progress:
        report = bench(
            arguments.rounds, arguments.seconds, arguments.priority, arguments.frame_rate, progress
        )
    print(json.dumps(report.to_json()) if arguments.json else report.to_text())
    _warn(report.missing)
    return 0


def _configuration_parsers(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    init = commands.add_parser(
        "init", help="write a configuration for a URDF; `init list`: devices"
    )
    init_arguments(init)
    init.set_defaults(command=_init)

    devices = commands.add_parser(
        "devices",
        help="list the codecs of units on serial lines, and where each is from",
    )
    devices.set_defaults(command=_devices)

    schema = commands.add_parser(
        "schema", help="print the configuration's JSON Schema, for editors; or keys in words"
    )
    schema.add_argument("part", nargs="?", metavar="KEY", help="a section or key, explained")
    schema.set_defaults(command=_schema)

    export_arguments(commands, _export)

    check_arguments(commands, _check)


def _warned(robot: Robot) -> Robot:
    """Print the warnings of a robot's configuration to stderr and return the robot."""
    _warn(f"{robot.config.name}: {text}" for text in robot.warnings)
    return robot


def _warn(texts: Iterable[str]) -> None:
    for text in texts:
        print(f"fsw: warning: {text}", file=sys.stderr)


def _config(arguments: argparse.Namespace) -> Config:
    """Return the effective configuration: the file with its overlays."""
    from fsw.config import load
    from fsw.config.overlay_file import with_overlays

    return with_overlays(load(arguments.config), arguments.overlay)


def _checked(config: Config) -> Config:
    """Validate a whole configuration, print its warnings to stderr and return it."""
    from fsw.checks.configuration import validate

    _, warnings = validate(config)
    _warn(f"{config.name}: {text}" for text in warnings)
    return config


def _run(arguments: argparse.Namespace) -> int:
    from fsw.checks.configuration import missing_devices, validate_ports
    from fsw.checks.outputs import validate_outputs

    config = _checked(_config(arguments))
    validate_ports(config)
    validate_outputs(config)
    for text in missing_devices(config):
        print(f"fsw: run: warning: {text}; it is opened once it is there", file=sys.stderr)
    words = "runs until Ctrl-C or SIGTERM; events that need an operator are shown, all of them are "
    words += "in events.jsonl of service.state_directory"
    print(f"fsw: run: {words}", file=sys.stderr)
    from fsw.exchange.tied import module_command
    from fsw.loop.app import RESTART_EXIT, run_live  # imported late: it can open devices

    code = run_live(config, cold=arguments.cold)
    if code == RESTART_EXIT:
        os.execv(sys.executable, [*module_command("fsw"), *sys.argv[1:]])
    return code


def _replay(arguments: argparse.Namespace) -> int:
    from offline.robot import Robot

    given = None if arguments.config is None else Robot(arguments.config)
    from offline.api import load, replay  # imported late: it can open recordings

    recording = load(arguments.recording)
    robot = (recording.robot if given is None else given).with_overlays(*arguments.overlay)
    robot = _warned(robot.with_choices(method=arguments.method, weighting=arguments.weighting))
    span = {"from_s": arguments.from_s, "to_s": arguments.to_s}
    with Progress("replay") as progress:
        result = replay(recording, robot, **span, progress=progress)
    print(json.dumps(result.to_json()) if arguments.json else result.to_text())
    _warn(result.warnings())
    valid = result.estimate is not None and result.estimate.valid and not result.missed
    return 0 if valid else FAILED_EXIT


def _report(arguments: argparse.Namespace) -> int:
    from offline.robot import Robot

    given = None if arguments.config is None else Robot(arguments.config)
    from offline.api import load, report  # imported late: it can open recordings
    from offline.report import LIVE

    recording = str(arguments.recording)
    robot = load(recording).robot if given is None and recording != LIVE else given
    if robot is not None:
        robot = robot.with_overlays(*arguments.overlay)
        chosen = robot.with_choices(method=arguments.method, weighting=arguments.weighting)
        robot = _warned(chosen)
    out = arguments.out or Path(arguments.recording.stem).with_suffix(".html")
    with Progress("report") as progress:
        progress(f"replaying {recording}")
        written = report(
            recording,
            robot,
            out,
            with_csv=arguments.csv,
            with_png=arguments.png,
            with_parquet=arguments.parquet,
            with_mcap=arguments.mcap,
            from_s=arguments.from_s,
            to_s=arguments.to_s,
            progress=progress,
        )
    print("\n".join([written.verdict, *map(str, written.paths)]))
    for line in written.result.warnings():
        if recording != LIVE:
            print(f"fsw: warning: {line}", file=sys.stderr)
    return 0 if written.valid and not written.result.missed else FAILED_EXIT


def _view(arguments: argparse.Namespace) -> int:
    from offline.robot import Robot

    robot = None if arguments.config is None else Robot(arguments.config)
    from offline.api import load  # imported late: it can open recordings
    from offline.view import PLANS, view

    source: Path = arguments.source
    if robot is None and source.suffix in PLANS:
        raise ConfigError("--config: a plan needs the configuration of its robot")
    robot = _warned((robot or load(source).robot).with_overlays(*arguments.overlay))
    out = arguments.out or Path(f"{source.stem}_motion.html")
    with Progress("view") as progress:
        written = view(source, robot.config, out, arguments.truth, progress)
    print(written)
    return 0


def _identify(arguments: argparse.Namespace) -> int:
    from offline.out_argument import refuse_no_folder, write_result
    from offline.robot import Robot

    refuse_no_folder(arguments.out, arguments.report)
    method, weighting, unknown = arguments.method, arguments.weighting, arguments.unknown
    given = None if arguments.config is None else Robot(arguments.config)
    from offline.api import identify, load  # imported late: it can open recordings

    robot = (given or load(arguments.recording).robot).with_overlays(*arguments.overlay)
    robot = _warned(robot.with_choices(method=method, weighting=weighting, unknown=unknown))
    if given is None:
        print(f"fsw: identify: by the configuration in {arguments.recording}", file=sys.stderr)

    with Progress("identify") as tell:

        def progress(_ratio: float, text: str) -> bool:
            tell(text)
            return True

        result = identify(
            arguments.recording,
            robot,
            method=method,
            from_s=arguments.from_s,
            to_s=arguments.to_s,
            holdout=arguments.holdout,
            reference=arguments.reference,
            report=arguments.report,
            progress=progress,
        )
    if arguments.out is not None:
        write_result(arguments.out, json.dumps(result.values))
    print(json.dumps(result.values) if arguments.json else result)
    return 0 if result.valid and result.passed is not False else FAILED_EXIT


def _import(arguments: argparse.Namespace) -> int:
    if arguments.out is None:
        raise ConfigError("--out: missing; where shall the recording go?")
    from offline.importing import import_recording
    from offline.replay import doubts_of

    config = _checked(_config(arguments))
    with Progress("import") as progress:
        written = import_recording(arguments, config, progress)
        progress("judging what can be used of it")
        doubts = doubts_of(arguments.out, config)
    print("\n".join(written))
    _warn(doubts)
    return 0


def _calibrate(arguments: argparse.Namespace) -> int:
    from offline.calibrate.command import calibrate

    with Progress("calibrate") as tell:
        text, shown = calibrate(arguments, tell)
    print(text)
    words = f"wrote {arguments.out}; use it with --overlay {arguments.out}"
    if not shown:
        words = "the data show no figure better than the configuration does; nothing is written"
    if arguments.out is not None or not shown:
        print(f"fsw: calibrate: {words}", file=sys.stderr)
    return 0 if shown else FAILED_EXIT


def _excite(arguments: argparse.Namespace) -> int:
    from offline.check import planning

    config = _checked(_config(arguments))
    with planning("excite"):
        from offline.excite import excite
    return excite(arguments, config)


def _ctl(arguments: argparse.Namespace) -> int:
    from fsw.service.ctl import reply_to

    reply = reply_to(_config(arguments), arguments.name, arguments.arguments)
    print(json.dumps(reply))
    return 0 if reply.get("accepted") else FAILED_EXIT


def _check(arguments: argparse.Namespace) -> int:
    from offline.check import check

    text, agree = check(_config(arguments), arguments.other)
    print(text)
    return 0 if agree else FAILED_EXIT


def _init(arguments: argparse.Namespace) -> int:
    from offline.init.command import init, listing

    print(listing() if str(arguments.urdf) == "list" else init(arguments))
    return 0


def _export(arguments: argparse.Namespace) -> int:
    if str(arguments.result) == "dictionary":
        from offline.exports import write

        print(*write(arguments.out or Path("inertia_dictionary")), sep="\n")
        return 0
    from offline.export_body import export
    from offline.ros2 import write_package

    if str(arguments.result) == "ros2":
        print(*write_package(arguments.out or Path("inertia_daemon_msgs")), sep="\n")
        return 0
    body, text = export(arguments)
    sys.stdout.write(text)
    if not body.valid:
        _warn([f"{arguments.result}: the estimate is not valid"])
    return 0 if body.valid else FAILED_EXIT


def _schema(arguments: argparse.Namespace) -> int:
    from fsw.config.reference import json_schema, keys_of

    words = (key.words() for key in keys_of(arguments.part)) if arguments.part else ()
    print("\n".join(words) or json.dumps(json_schema(), indent=2))
    return 0


def _devices(_arguments: argparse.Namespace) -> int:
    from offline.init.devices import codec_listing

    print(codec_listing())
    return 0


def _install_service(arguments: argparse.Namespace) -> int:
    from fsw.service.install_service import install

    config, files = _checked(_config(arguments)), [arguments.config, *arguments.overlay]
    print(install(config, files, arguments.user, arguments.directory))
    return 0


if __name__ == "__main__":
    sys.exit(main())
