"""Commands of the long evidence: fuzz, kills and soak. Resumable; what they need comes late."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress

FAILED_EXIT = 1


def add_parsers(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommands."""
    fuzz = commands.add_parser("fuzz", help="coverage-guided fuzzing of every byte parser")
    fuzz.add_argument("--inputs", type=float, default=1e7, metavar="N", help="in all, 1e7")
    fuzz.add_argument("--seed", type=int, default=0, metavar="K", help="of the mutations")
    fuzz.add_argument("--out", type=Path, required=True, metavar="DIR", help="resumed from there")
    fuzz.add_argument("--keep", type=Path, metavar="DIR", help="copy a small corpus there")
    fuzz.set_defaults(command=_fuzz)


def bar() -> Progress:
    """Return a progress bar on stderr."""
    from rich.console import Console
    from rich.progress import Progress

    return Progress(console=Console(stderr=True))


def _fuzz(arguments: argparse.Namespace) -> int:
    from hil.fuzz.campaign import Bout, keep, run
    from hil.fuzz.table import quota

    inputs = int(arguments.inputs)
    with bar() as progress:
        tasks = {name: progress.add_task(name, total=n) for name, n in quota(inputs).items()}

        def tell(bout: Bout) -> None:
            progress.advance(tasks[bout.target], bout.inputs)
            if bout.failure:
                progress.console.print(f"{bout.target}: {bout.failure}", markup=False)

        result = run(inputs, arguments.out.absolute(), arguments.seed, tell)
    if arguments.keep is not None:
        keep(arguments.out.absolute(), arguments.keep, most=24, most_bytes=2048)
    print(json.dumps(result))
    return FAILED_EXIT if result["failed"] else 0
