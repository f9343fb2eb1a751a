"""A fuzzing campaign: each target runs in bouts, and each bout in a separate process.

`DIR/results.jsonl` has the result of each bout, so that a campaign can be resumed. Coverage grows
the corpus in `DIR/corpus/TARGET`. `DIR/failed` has the inputs that failed.
"""

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from evidence.fuzz.oracle import MAX_INPUT_BYTES
from evidence.fuzz.seeds import seeds
from evidence.fuzz.table import TARGETS, quota
from evidence.store import Row, Store
from hil.run.processes import tied

BOUT_INPUTS = 50_000
SEQUENCES = 2_000  # inputs of a bout of the target operations: each has about ten commands
SHORT_INPUT_BYTES = 128  # longest input of most bouts, because the cost grows with the length
LONG_EVERY = 16  # every 16th bout has inputs of up to MAX_INPUT_BYTES
RSS_LIMIT_MB = 1024
TIMEOUT_S = 900  # of one input in wall-clock time, so long that a campaign can be paused
BOUT_LIMIT_S = 3600.0
_UNITS = re.compile(r"stat::number_of_executed_units:\s+(\d+)")
_RSS = re.compile(r"stat::peak_rss_mb:\s+(\d+)")


@dataclass(frozen=True, slots=True)
class Bout:
    """The result of one bout."""

    target: str
    inputs: int  # executed inputs
    peak_rss_mb: int
    failure: str  # empty without a failure


def bout(target: str, inputs: int, seed: int, most_bytes: int, folder: Path) -> Bout:
    """Run a target in a separate process with `inputs` inputs of at most `most_bytes`."""
    corpus = folder / "corpus" / target
    failed = folder / "failed"
    failed.mkdir(parents=True, exist_ok=True)
    if not corpus.exists():
        corpus.mkdir(parents=True)
        for number, data in enumerate(seeds(target)):
            (corpus / f"seed-{number:02d}").write_bytes(data)
    options = {
        "runs": inputs + len(list(corpus.iterdir())),
        "seed": seed,
        "max_len": most_bytes,
        "len_control": 20,
        "timeout": TIMEOUT_S,
        "rss_limit_mb": RSS_LIMIT_MB,
        "print_final_stats": 1,
        "artifact_prefix": f"{failed}/{target}-",
    }
    command = [sys.executable, "-m", "evidence.fuzz.child", target]
    command += [f"-{key}={value}" for key, value in options.items()]
    done = subprocess.run(
        tied([*command, str(corpus)]),
        capture_output=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        timeout=BOUT_LIMIT_S,
        check=False,
    )
    text = done.stderr.decode(errors="replace")
    units, rss = _UNITS.search(text), _RSS.search(text)
    failure = "" if done.returncode == 0 and units else _why(done.returncode, done.stdout)
    return Bout(target, int(units[1]) if units else 0, int(rss[1]) if rss else 0, failure)


def _why(code: int, output: bytes) -> str:
    """Return the exit code and the end of the traceback that atheris prints."""
    return f"exit {code}: {output.decode(errors='replace').strip()[-1000:]}"


def longest(target: str, number: int) -> int:
    """Return the largest length of the inputs in a bout of a target [byte]."""
    if number % LONG_EVERY == 0:
        return MAX_INPUT_BYTES
    return max(SHORT_INPUT_BYTES, *(len(data) for data in seeds(target)))


def campaign(inputs: int, folder: Path, seed: int, only: str = "") -> Iterator[Bout]:
    """Run and yield bouts until every target has had its share, or has failed.

    Bouts of earlier calls in the same folder count.

    Raises
    ------
    ScenarioError if the folder has a campaign with another seed.
    """
    store = Store(folder, {"seed": seed})
    states = summary(folder, store)["targets"]
    for target, share in quota(inputs, only).items():
        held = states[target]
        while held["inputs"] < share and not held["failure"]:
            most = SEQUENCES if target == "operations" else BOUT_INPUTS
            count, number = min(most, share - held["inputs"]), held["bouts"]
            most_bytes = longest(target, number)
            result = bout(target, count, seed + number + 1, most_bytes, folder)
            store.add(f"{target}-{number}", asdict(result))
            _count(held, asdict(result))
            yield result


def summary(folder: Path, store: Store) -> dict[str, Any]:
    """Return the counts of inputs, the corpus sizes and the failures of a campaign."""
    targets: dict[str, dict[str, Any]] = {
        target: {"inputs": 0, "bouts": 0, "rss_mb": 0, "failure": ""} for target in TARGETS
    }
    for row in store.rows.values():
        _count(targets[row["target"]], row)
    for target, held in targets.items():
        corpus = folder / "corpus" / target
        held["corpus"] = len(list(corpus.iterdir())) if corpus.exists() else 0
    return {
        "inputs": sum(held["inputs"] for held in targets.values()),
        "least": min(held["inputs"] for held in targets.values()),
        "failed": sorted(target for target, held in targets.items() if held["failure"]),
        "targets": targets,
    }


def _count(held: dict[str, Any], row: Row) -> None:
    """Add a bout to the counts of its target."""
    held["inputs"] += row["inputs"]
    held["bouts"] += 1
    held["rss_mb"] = max(held["rss_mb"], row["peak_rss_mb"])
    held["failure"] = row["failure"]


def run(
    inputs: int, folder: Path, seed: int, tell: Callable[[Bout], None], only: str = ""
) -> dict[str, Any]:
    """Run a campaign to its end, call `tell` with every bout, and return the summary."""
    for result in campaign(inputs, folder, seed, only):
        tell(result)
    return summary(folder, Store(folder, {"seed": seed}))


def keep(folder: Path, kept: Path, most: int, most_bytes: int) -> None:
    """Copy at most `most` small files of each corpus, of all sizes, for regression tests."""
    for target in sorted(path.name for path in (folder / "corpus").iterdir()):
        files = [(path.stat().st_size, path) for path in (folder / "corpus" / target).iterdir()]
        small = sorted(item for item in files if item[0] <= most_bytes)
        count = min(most, len(small))
        (kept / target).mkdir(parents=True, exist_ok=True)
        for _, path in (small[k * len(small) // count] for k in range(count)):
            (kept / target / path.name).write_bytes(path.read_bytes())
