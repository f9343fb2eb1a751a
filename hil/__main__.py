"""Command line of the bench: run a scenario and judge it, or list the scenarios.

Exit codes: 0 done, 1 the run failed, 2 the scenario or configuration is wrong.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from evidence import commands as evidence
from hil.basilisk import command as vs_basilisk
from hil.examples import EXAMPLES
from hil.options import add_own, call, count, require_own, seed

if TYPE_CHECKING:
    from rich.console import Console

    from hil.world.scenario import Scenario

WRONG_EXIT = 2
FAILED_EXIT = 1
SCIENCE_INTERVAL_S = 0.1  # of the telemetry of `run --telemetry`
PLAIN_WIDTH = 120  # of output that goes to a file or a pipe


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand and return the exit code."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: one core, one result
    arguments = parser().parse_args(argv)
    from hil.errors import explained
    from offline.out_argument import refuse_existing

    def action() -> int:
        if "force" in arguments:
            refuse_existing(arguments)
        return call(arguments)

    return explained(action, WRONG_EXIT, FAILED_EXIT, getattr(arguments, "out", None))


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands; shell completion and documentation use it too."""
    program = argparse.ArgumentParser(prog="hil", description=__doc__)
    release = f"%(prog)s {version('inertia-daemon')}"
    program.add_argument("--version", action="version", version=release)
    commands = program.add_subparsers(required=True, metavar="COMMAND")
    run = commands.add_parser("run", help="run a scenario against the daemon and judge the result")
    run.add_argument("scenario", metavar="SCENARIO", help="a name from `hil list`, or a YAML file")
    run.add_argument("--fast", action="store_true", help="virtual time, one thread, deterministic")
    run.add_argument("--seed", type=seed, default=0, metavar="K", help="fixes every random bit")
    run.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    run.add_argument(
        "--out", type=Path, metavar="DIR", help="keep configuration, recording, picture, result"
    )
    run.add_argument("--force", action="store_true", help="overwrite --out")
    run.add_argument(
        "--bus",
        choices=("auto", "socketcan", "udp_multicast", "udp_frames"),
        default="auto",
        help="of a run in real time; auto: vcan0 where this kernel has it and nobody uses it",
    )
    run.add_argument("--truth", type=Path, metavar="FILE", help="of hil vs-basilisk, with --fast")
    run.add_argument("--method", choices=("mrnea", "fused"), help="instead of the scenario's")
    run.add_argument("--weighting", choices=("ols", "wls", "eiv"), help="instead of the scenario's")
    run.add_argument(
        "--telemetry",
        type=int,
        metavar="PORT",
        help="of a run in real time: the daemon's link for the ground listens on this TCP port",
    )
    _add_settings(run)
    add_own(run)
    run.set_defaults(command=_run)
    seeds = commands.add_parser(
        "seeds", help="many seeds of a scenario, and what they say together"
    )
    seeds.add_argument("scenario", metavar="SCENARIO")
    which = seeds.add_mutually_exclusive_group()
    which.add_argument("--first", type=seed, default=0, metavar="K", help="first seed, 0")
    which.add_argument(
        "--fresh",
        action="store_true",
        help="seeds that the commit's hash fixes: nobody has used them before",
    )
    seeds.add_argument("--count", type=count, default=10, metavar="N", help="consecutive seeds, 10")
    seeds.add_argument("--jobs", type=count, default=1, metavar="N", help="runs at a time, 1")
    seeds.add_argument(
        "--real-time", action="store_true", help="live links instead of virtual time"
    )
    seeds.add_argument("--out", type=Path, metavar="DIR", help="keep outcomes and resume")
    seeds.add_argument("--json", action="store_true", help="print outcomes and summary as JSON")
    _add_settings(seeds)
    add_own(seeds)
    seeds.set_defaults(command=_seeds)
    commands.add_parser("list", help="list the scenarios").set_defaults(command=_list)
    schema = commands.add_parser("schema", help="the keys of a scenario, explained")
    schema.add_argument("part", nargs="?", default="", metavar="KEY", help="a section or key")
    schema.set_defaults(command=_schema)
    study = commands.add_parser("study", help="studies over many seeds")
    _vcan_parser(commands)
    evidence.add_parsers(commands, study.add_subparsers(required=True, metavar="STUDY"))
    vs_basilisk.add_parser(commands)
    for name, example in EXAMPLES.items():
        commands.choices[name].epilog = f"example: {example}"
    return program


def _add_settings(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="settings",
        help="a setting of the scenario's sensors, flight software or rests, such as"
        " sensors.joints.torque_noise_correlation_s=0.02 or timing.before_s=60; may be repeated",
    )


def _vcan_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    vcan = commands.add_parser(
        "vcan",
        help="run a command with a real vcan0 and vcan1",
        description="Run a command with SocketCAN links vcan0 and vcan1: this kernel's, or those of"
        " a User-Mode Linux that shares this machine's files. Output and exit status are the"
        " command's; 124: out of time, 125: it could not be run, 128 + n: ended by signal n.",
    )
    vcan.add_argument(
        "--timeout", type=float, metavar="S", dest="timeout_s", help="end the command after so long"
    )
    vcan.add_argument(
        "--realtime",
        action="store_true",
        help="User-Mode Linux in SCHED_FIFO on one processor, where that is allowed",
    )
    vcan.add_argument("--on", choices=("auto", "kernel", "uml"), default="auto", dest="where")
    vcan.add_argument("argv", nargs="+", metavar="COMMAND", help="and its arguments, after --")
    vcan.set_defaults(function="hil.vcan.command:run")


def _schema(arguments: argparse.Namespace) -> int:
    from hil.scenario_keys import keys_of

    print("\n".join(key.words().rstrip() for key in keys_of(arguments.part)))
    return 0


def _list(_arguments: argparse.Namespace) -> int:
    from hil.world.scenario import load, names

    for name in names():
        print(f"{name:12s} {load(name).title}")
    return 0


def _seeds(arguments: argparse.Namespace) -> int:
    from evidence.provenance import commit, seed_or_fresh
    from evidence.seeds import run_seeds, show, summary
    from evidence.settings import settled

    require_own(arguments)
    doubts = ["--doubts"] if arguments.doubts else []
    study = " ".join((arguments.scenario, *arguments.settings, *doubts))
    first = seed_or_fresh(None if arguments.fresh else arguments.first, study)
    settled(arguments.scenario, arguments.settings, first)  # a wrong setting fails once
    numbers = range(first, first + arguments.count)
    options = doubts if arguments.real_time else [*doubts, "--fast"]
    options += [word for setting in arguments.settings for word in ("--set", setting)]
    files = {k: path for k in ("config", "devices") if (path := getattr(arguments, k)) is not None}
    outcomes = run_seeds(arguments.scenario, numbers, arguments.jobs, options, arguments.out, files)
    if arguments.json:
        print(json.dumps({"commit": commit(), "summary": summary(outcomes), "runs": outcomes}))
    else:
        print(f"commit {commit()}, seeds {numbers[0]} to {numbers[-1]}")
        show(outcomes, _console())
    return 0 if all(outcome["valid"] for outcome in outcomes) else FAILED_EXIT


def _run(arguments: argparse.Namespace) -> int:
    def say(text: str) -> None:
        print(f"hil: run: {text}", file=sys.stderr)

    say("preparing world, devices and flight software")
    from evidence.settings import settled
    from file_delivery.durable import replace_file
    from hil.judge import judgement, page, report
    from hil.judge.text import show
    from hil.run import bench
    from hil.run.default_doubts import write_with_doubts
    from hil.run.own_flight import own_world
    from hil.run.progress import meter
    from hil.world.scenario import ScenarioError

    _require_together(arguments)
    telemetry = None
    if arguments.telemetry is not None:
        telemetry = {"port": arguments.telemetry, "science_interval_s": SCIENCE_INTERVAL_S}
    scenario = settled(arguments.scenario, arguments.settings, arguments.seed)
    overrides = {k: v for k in ("method", "weighting") if (v := getattr(arguments, k)) is not None}
    with ExitStack() as stack:
        folder = _folder(arguments, scenario.name, stack)
        config = arguments.config
        if arguments.doubts:
            config = write_with_doubts(scenario, arguments.seed, folder / "doubts")
        scenario, own = own_world(scenario, config, arguments.devices, arguments.seed, folder)
        if not arguments.fast:
            scenario = _linked(scenario, arguments.bus, stack)
        try:
            setup = bench.prepare(
                scenario,
                arguments.seed,
                folder,
                real_time=not arguments.fast,
                overrides=overrides,
                telemetry=telemetry,
                truth=arguments.truth,
                own=own,
            )
        except (OSError, ValueError) as error:  # of the files that `prepare` reads
            raise ScenarioError(" ".join(str(error).split())) from error
        with meter(scenario.name, setup.total_s, _console(stderr=True)) as bar:
            if arguments.fast:
                recorded = bench.run_virtual(setup, bar, record=arguments.out is not None)
            else:
                recorded = bench.run_live(setup, bar)
        say("judging the result against the truth")
        case = judgement.make_case(setup)
        outcome = judgement.judge(setup, case, recorded)
        replace_file(folder / "result.json", json.dumps(outcome, indent=1))
        picture = None
        if arguments.out is not None or not arguments.json:
            say("drawing")
            story = judgement.make_story(setup, case, recorded, outcome)
            picture = report.save(story, folder / "report.png")
            page.save(
                story, outcome, judgement.channel_sections(setup, recorded), folder / "report.html"
            )
        if arguments.json:
            print(json.dumps(outcome))
        else:
            show(outcome, picture, _console())
    return 0 if outcome["valid"] else FAILED_EXIT


def _folder(arguments: argparse.Namespace, name: str, stack: ExitStack) -> Path:
    """Return the folder of a run; one that nobody named and nobody reads is deleted at the end."""
    if arguments.out is not None:
        folder: Path = arguments.out
    elif arguments.json:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hil-")))
    else:
        folder = Path("runs") / f"{name}-{arguments.seed}"
    return folder.absolute()


def _require_together(arguments: argparse.Namespace) -> None:
    """Raise ScenarioError for options of a run of which one excludes or needs another."""
    from hil.world.scenario import ScenarioError

    if arguments.fast and arguments.telemetry is not None:
        raise ScenarioError("--telemetry: a run in virtual time has no link; leave --fast out")
    if arguments.truth is not None and not arguments.fast:
        raise ScenarioError("--truth: needs virtual time: add --fast")
    if arguments.truth is not None and (arguments.doubts or arguments.config is not None):
        raise ScenarioError("--truth: not with --config or --doubts, which change the arm")
    require_own(arguments)


def _linked(scenario: Scenario, choice: str, stack: ExitStack) -> Scenario:
    """Return the scenario on the buses of a real-time run. Raises LiveError if one is missing."""
    from hil.run.flight import on_frames, on_socketcan
    from hil.run.live import require_multicast

    if _has_socketcan(choice, stack):
        return on_socketcan(scenario)
    if choice == "udp_frames":
        scenario = on_frames(scenario)
    for bus in scenario.buses.values():
        require_multicast(bus)
    return scenario


def _has_socketcan(choice: str, stack: ExitStack) -> bool:
    """Return whether the run uses vcan0, which stays claimed until the stack closes."""
    from hil.run.live import LiveError
    from hil.vcan import kernel

    if choice.startswith("udp_"):
        return False
    ready = stack.enter_context(kernel.claimed())
    if not ready and choice == "socketcan":
        raise LiveError(
            "no vcan0 and vcan1 here, or another run has them; `hil vcan -- hil run ...`"
        )
    return ready


def _console(*, stderr: bool = False) -> Console:
    """Return a console; in a file or a pipe it has at least PLAIN_WIDTH columns."""
    from rich.console import Console

    console = Console(stderr=stderr, markup=False)  # units stand in brackets
    console.width = console.width if console.is_terminal else max(console.width, PLAIN_WIDTH)
    return console


if __name__ == "__main__":
    sys.exit(main())
