"""Commands of the long evidence, from `hil fuzz` to `hil bench`; each imports its modules late."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.evidence.lies import arguments as lies
from hil.options import add_resumable, count, count_or_none, seed

if TYPE_CHECKING:
    from rich.progress import Progress

FAILED_EXIT = 1
Rows = list[dict[str, Any]]


def add_parsers(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommands."""
    fuzz = commands.add_parser("fuzz", help="coverage-guided fuzzing of every byte parser")
    fuzz.add_argument("--inputs", type=float, default=1e7, metavar="N", help="in all, 1e7")
    fuzz.add_argument("--seed", type=seed, default=0, metavar="K", help="of the mutations")
    fuzz.add_argument("--out", type=Path, required=True, metavar="DIR", help="resumed from there")
    fuzz.add_argument("--keep", type=Path, metavar="DIR", help="copy a small corpus there")
    fuzz.add_argument("--only", default="", metavar="TARGET", help="all inputs for one target")
    fuzz.add_argument(
        "--live", action="store_true", help="with --only operations: real processes, N cases"
    )
    fuzz.add_argument(
        "--random", action="store_true", help="with --only operations: N cases, no coverage, fast"
    )
    fuzz.set_defaults(command=_fuzz)
    kills = commands.add_parser("kills", help="kill -9 of loop and service in a real-time run")
    kills.add_argument("--count", type=count, default=200, metavar="N", help="in all, 200")
    kills.add_argument("--seed", type=seed, default=0, metavar="K", help="of instants and victims")
    kills.add_argument("--out", type=Path, required=True, metavar="DIR", help="resumed from there")
    kills.set_defaults(command=_kills)
    transfers = commands.add_parser("transfers", help="file transfers, a quarter interrupted")
    transfers.add_argument("--count", type=count, default=200, metavar="N", help="in all, 200")
    transfers.add_argument(
        "--seed", type=seed, default=0, metavar="K", help="of files and instants"
    )
    transfers.add_argument("--out", type=Path, required=True, metavar="DIR", help="resumed there")
    transfers.set_defaults(command=_transfers)
    wrong = commands.add_parser("mistakes", help="mistakes of configuration: valid and wrong?")
    cases = "target, base, both, or bench_target (clamped, under gravity); all"
    wrong.add_argument("--case", action="append", default=[], help=cases)
    wrong.add_argument("--only", action="append", default=[], metavar="NAME", help="this mistake")
    wrong.add_argument("--seed", type=seed, default=0, metavar="K", help="of priors and noise")
    wrong.add_argument(
        "--exact", action="store_true", help="arm and calibration declared as exact, not in doubt"
    )
    wrong.add_argument("--robot", default="", metavar="FILE", help="a scenario of your own robot")
    wrong.add_argument("--json", action="store_true", help="print one JSON list")
    wrong.add_argument(
        "--recording", action="store_true", help="also import, check and identify a recording"
    )
    wrong.set_defaults(command=_mistakes)
    _add_calibration(commands)
    _add_real(commands)
    _add_alarms(commands)
    soak = commands.add_parser("soak", help="hours in virtual time under random faults")
    soak.add_argument("--hours", type=float, default=2.0, metavar="H", help="virtual, 2")
    soak.add_argument("--rate", type=float, default=500.0, metavar="HZ", help="bus and loop, 500")
    soak.add_argument("--imu-rate", type=int, default=500, metavar="HZ", help="500")
    soak.add_argument("--seed", type=seed, default=0, metavar="K", help="fixes every bit")
    soak.add_argument("--jobs", type=count, default=1, metavar="N", help="quarters at a time, 1")
    soak.add_argument("--out", type=Path, required=True, metavar="DIR", help="resumed from there")
    soak.set_defaults(command=_soak)
    bench = commands.add_parser("bench", help="the whole daemon in real time, alone and loaded")
    bench.add_argument("scenario", nargs="?", default="target_leo", metavar="SCENARIO")
    bench.add_argument("--rounds", type=count, default=5, metavar="N", help="of every condition, 5")
    bench.add_argument("--seconds", type=float, default=30.0, metavar="S", help="of a run, 30")
    bench.add_argument(
        "--only",
        action="append",
        default=[],
        choices=("alone", "hog", "batch", "clients"),
        help="this condition; may be repeated",
    )
    bench.add_argument(
        "--bus",
        choices=("udp_multicast", "udp_frames"),
        default="udp_multicast",
        help="udp_frames: frames as sockets of SocketCAN hand them over",
    )
    bench.add_argument("--out", type=Path, metavar="DIR", help="keep the runs and resume")
    bench.add_argument("--json", action="store_true", help="print one JSON object")
    bench.set_defaults(command=_bench)


def _add_alarms(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    alarms = commands.add_parser("alarms", help="clean flights on fresh seeds: which checks fire?")
    alarms.add_argument(
        "--scenario", action="append", default=[], help="this one; may be repeated; nine"
    )
    alarms.add_argument(
        "--samples", type=count_or_none, default=1000, metavar="N", help="flights of each, 1000"
    )
    alarms.add_argument(
        "--bytes",
        type=count_or_none,
        default=100,
        metavar="N",
        dest="from_bytes",
        help="flights of each from the devices' bytes, 100",
    )
    add_resumable(alarms, "flights")
    alarms.set_defaults(function="hil.evidence.alarms.command:run")
    lies.add_parser(commands)


def _add_real(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    hardware = commands.add_parser("hardware", help="recordings of real arms, fetched if wanted")
    hardware.add_argument(
        "--data", type=Path, required=True, metavar="DIR", help="where the recordings lie"
    )
    hardware.add_argument("--fetch", action="store_true", help="load what is missing from GitHub")
    hardware.add_argument(
        "--repository",
        type=Path,
        action="append",
        default=[],
        dest="repositories",
        metavar="DIR",
        help="with --fetch: a local git repository of the data; may be repeated",
    )
    hardware.add_argument(
        "--arm",
        action="append",
        default=[],
        dest="arms",
        metavar="NAME",
        help="this one, such as ur10e; may be repeated; default: all",
    )
    hardware.add_argument(
        "--held-out", action="store_true", help="judge also the runs that no choice has used"
    )
    hardware.add_argument("--out", type=Path, metavar="DIR", help="keep what was imported")
    hardware.add_argument("--json", action="store_true", dest="as_json", help="print one JSON list")
    hardware.add_argument(
        "--throws",
        action="store_true",
        help="of thrown bodies with a reaction wheel instead; needs orangebox",
    )
    hardware.set_defaults(function="hil.evidence.hardware.command:run")


def _add_calibration(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    calibration = commands.add_parser("calibration", help="fsw calibrate against wrong sensors")
    calibration.add_argument(
        "--scenario",
        action="append",
        default=[],
        choices=("target_leo", "table_target", "bench_target"),
        help="this one; may be repeated",
    )
    add_seeds(calibration, 20, "object")
    calibration.set_defaults(command=_calibration)
    rough = commands.add_parser("rough", help="friction, wrong links, coloured noise: honest?")
    rough.add_argument(
        "--case",
        action="append",
        default=[],
        choices=("target", "base", "both"),
        help="what is unknown; may be repeated",
    )
    rough.add_argument(
        "--told",
        action="append",
        default=[],
        choices=("declared", "undeclared", "exact", "terms", "defaults"),
        help="rough world declared or undeclared; ideal one, declared as exact, with the terms of"
        " the rough one, with default uncertainties; may be repeated",
    )
    add_seeds(rough, 50, "list")
    rough.set_defaults(command=_rough)
    imported = commands.add_parser("imported", help="tables of an arm: motion, poses, a wrist")
    imported.add_argument(
        "--motion",
        action="append",
        default=[],
        choices=("moving", "poses"),
        help="this one; may be repeated",
    )
    add_seeds(imported, 10, "list")
    imported.set_defaults(command=_imported)
    differential = commands.add_parser("differential", help="same motion, empty: half the error?")
    add_seeds(differential, 20, "object")
    differential.set_defaults(command=_differential)


def add_seeds(command: argparse.ArgumentParser, number: int, printed: str) -> None:
    """Add the options of evidence over seeds; `printed` names the JSON type in the help text."""
    command.add_argument("--first", type=seed, default=0, metavar="K", help="first seed, 0")
    command.add_argument(
        "--count", type=count, default=number, metavar="N", help=f"seeds, {number}"
    )
    command.add_argument("--jobs", type=count, default=1, metavar="N", help="processes, 1")
    command.add_argument("--out", type=Path, metavar="DIR", help="keep what was found and resume")
    command.add_argument("--json", action="store_true", help=f"print one JSON {printed}")


def bar() -> Progress:
    """Return a progress bar on stderr."""
    from rich.console import Console
    from rich.progress import Progress

    return Progress(console=Console(stderr=True))


def _fuzz(arguments: argparse.Namespace) -> int:
    from hil.evidence.fuzz.campaign import Bout, keep, run
    from hil.evidence.fuzz.table import TARGETS, quota
    from hil.world.scenario import ScenarioError

    inputs, only = int(arguments.inputs), arguments.only
    if only and only not in TARGETS:
        raise ScenarioError(f"--only: {only!r} is none of {', '.join(TARGETS)}")
    if arguments.live:
        if only != "operations":
            raise ScenarioError("--live: needs --only operations")
        return _attack(inputs, arguments.out.absolute(), arguments.seed)
    if arguments.random:
        if only != "operations":
            raise ScenarioError("--random: needs --only operations")
        return _many(inputs, arguments.out.absolute(), arguments.seed)
    shares = quota(inputs, only)
    with bar() as progress:
        tasks = {name: progress.add_task(name, total=n) for name, n in shares.items()}

        def tell(bout: Bout) -> None:
            progress.advance(tasks[bout.target], bout.inputs)
            if bout.failure:
                progress.console.print(f"{bout.target}: {bout.failure}", markup=False)

        result = run(inputs, arguments.out.absolute(), arguments.seed, tell, only)
    if arguments.keep is not None:
        keep(arguments.out.absolute(), arguments.keep, most=24, most_bytes=2048)
    print(json.dumps(result))
    return FAILED_EXIT if result["failed"] else 0


def _attack(cases: int, folder: Path, seed: int) -> int:
    from hil.evidence.fuzz.live import run

    folder.mkdir(parents=True, exist_ok=True)
    with bar() as progress:
        task = progress.add_task("cases", total=cases)
        result = run(cases, folder, seed, lambda done: progress.update(task, completed=done))
    print(json.dumps(result))
    return FAILED_EXIT if result["faults"] or result["missed"] else 0


def _many(cases: int, folder: Path, seed: int) -> int:
    from hil.evidence.fuzz.many import blocks, summary
    from hil.evidence.store import Store

    store, failed = Store(folder, {"seed": seed, "cases": cases}), False
    with bar() as progress:
        done = sum(row["cases"] for row in store.rows.values())
        task = progress.add_task("cases", total=cases, completed=done)
        for block in blocks(cases, seed, store):
            progress.advance(task, block.cases)
            if block.failure:
                progress.console.print(f"block {block.number}: {block.failure}", markup=False)
                failed = True
    print(json.dumps(summary(store)))
    return FAILED_EXIT if failed else 0


def _calibration(arguments: argparse.Namespace) -> int:
    from hil.evidence.calibration.command import calibration, show

    rows = calibration(arguments.scenario, *_seeds(arguments))
    if arguments.json:
        print(json.dumps(rows))
    else:
        show(rows, arguments.count)
    return FAILED_EXIT if any(row["beyond"] for row in rows) else 0


def _rough(arguments: argparse.Namespace) -> int:
    from hil.evidence.rough.command import rough, show

    return _judged(arguments, rough(arguments.case, arguments.told, *_seeds(arguments)), show)


def _imported(arguments: argparse.Namespace) -> int:
    from hil.evidence.imported.command import imported, show

    return _judged(arguments, imported(arguments.motion, *_seeds(arguments)), show)


def study_effects(arguments: argparse.Namespace) -> int:
    """Run `hil study effects`; return the exit code, 0 if every row passed."""
    from hil.evidence.effects.command import effects, show

    return _judged(arguments, effects(arguments.scenarios, *_seeds(arguments)), show)


def _seeds(arguments: argparse.Namespace) -> tuple[range, int, Path | None]:
    """Return the seeds, the number of processes and the folder from the options of `add_seeds`."""
    seeds = range(arguments.first, arguments.first + arguments.count)
    return seeds, arguments.jobs, arguments.out


def _judged(arguments: argparse.Namespace, rows: Rows, show: Callable[[Rows], None]) -> int:
    """Print the rows; return the exit code, 0 if every row passed."""
    if arguments.json:
        print(json.dumps(rows))
    else:
        show(rows)
    return 0 if all(row["passed"] for row in rows) else FAILED_EXIT


def _differential(arguments: argparse.Namespace) -> int:
    from hil.evidence.differential import differential, lines

    found = differential(*_seeds(arguments))
    print(json.dumps(found) if arguments.json else lines(found))
    return 0 if found["passed"] else FAILED_EXIT


def _mistakes(arguments: argparse.Namespace) -> int:
    from dataclasses import asdict

    from hil.evidence.mistakes.command import findings, line, summary

    chosen = (arguments.case, arguments.only, arguments.seed)
    found = []
    for one in findings(
        *chosen, exact=arguments.exact, robot=arguments.robot, recording=arguments.recording
    ):
        found.append(one)
        if not arguments.json:
            print(line(one), flush=True)
    text, passed = summary(found)
    print(json.dumps([asdict(one) for one in found]) if arguments.json else text)
    return 0 if passed else FAILED_EXIT


def _transfers(arguments: argparse.Namespace) -> int:
    from hil.evidence.transfers.campaign import campaign, open_store, summary

    folder = arguments.out.absolute()
    with bar() as progress:
        task = progress.add_task("transfers", total=arguments.count)
        for result in campaign(arguments.count, folder, arguments.seed):
            progress.update(task, completed=result.number + 1)
            if result.fault:
                progress.console.print(f"{result.number}: {result.fault}", markup=False)
    found = summary(open_store(folder, arguments.seed))
    print(json.dumps(found))
    return FAILED_EXIT if found["faults"] or found["late"] else 0


def _kills(arguments: argparse.Namespace) -> int:
    from hil.evidence.kills.campaign import run, summary
    from hil.run.live import LiveError

    folder, failed = arguments.out.absolute(), False
    with bar() as progress:
        task = progress.add_task("kills", total=arguments.count)
        for kill in run(arguments.count, folder, arguments.seed):
            if isinstance(kill, LiveError):
                progress.console.print(str(kill), markup=False)
                failed = True
                continue
            progress.advance(task)
            for fault in (*kill.faults, *kill.late):
                text = f"round {kill.round} kill {kill.number} ({kill.victim}): {fault}"
                progress.console.print(text, markup=False)
    result = summary(folder, arguments.seed)
    print(json.dumps(result))
    return FAILED_EXIT if failed or result["faults"] or result["late"] else 0


def _soak(arguments: argparse.Namespace) -> int:
    from hil.evidence.soak.campaign import SCENARIO, open_store, plan, soak, summary
    from hil.evidence.soak.epoch import SoakSegment
    from hil.world.scenario import load
    from hil.world.spline import JointSpline

    chosen = (arguments.hours, arguments.rate, arguments.imu_rate, arguments.seed)
    folder = arguments.out.absolute()
    whole = len(open_store(folder, *chosen).rows)
    motion_s = JointSpline.load(load(SCENARIO).identification).duration_s
    epochs, segments = plan(arguments.hours, motion_s)
    with bar() as progress:
        task = progress.add_task("soak", total=epochs * segments, completed=whole * segments)

        def announce(segment: SoakSegment) -> None:
            progress.advance(task)
            for text in segment.broken:
                place = f"epoch {segment.epoch} segment {segment.number}"
                progress.console.print(f"{place}: {text}", markup=False)

        store = soak(*chosen, folder, arguments.jobs, announce)
    result = summary(store)
    print(json.dumps(result))
    return FAILED_EXIT if result["broken"] else 0


def _bench(arguments: argparse.Namespace) -> int:
    import sys

    from rich.console import Console

    from hil.evidence.speed import whole
    from hil.evidence.store import Store
    from hil.run.progress import meter

    names = arguments.only or whole.CONDITIONS
    scenario, seconds = arguments.scenario, arguments.seconds
    store = Store(arguments.out, {"bench": scenario, "seconds": seconds, "bus": arguments.bus})
    rounds = []
    for k in range(arguments.rounds):
        for name in names:
            key, title = f"{name} {k}", f"round {k + 1} of {arguments.rounds}, {name}"
            if key not in store.rows:
                console = Console(stderr=True)
                with meter(title, seconds + whole.SETTLE_S, console) as shown:
                    run = whole.measure(scenario, name, seconds, shown, arguments.bus)
                sys.stderr.write(run.to_text() + "\n")
                store.add(key, asdict(run))
        rounds.append([whole.Condition(**store.rows[f"{name} {k}"]) for name in names])
    print(whole.as_json(rounds) if arguments.json else whole.summary(rounds))
    return 0
