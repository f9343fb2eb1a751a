"""Where runs are done: processes of this machine, or the workers of a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from hil.evidence.campaign.config import Run
from hil.evidence.campaign.work import attempt
from hil.run.processes import end_with_driver
from hil.world.scenario import ScenarioError

MOST_ATTEMPTS = 3  # of a run whose worker dies
AHEAD = 4  # runs handed out per worker: few are lost with it
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

Row = dict[str, Any]


def local(runs: Sequence[Run], workers: int) -> Iterator[Row]:
    """Yield rows as they come; a worker that dies is replaced and its runs are done again."""
    for name in ONE_THREAD:  # new processes read them before their libraries start
        os.environ[name] = "1"
    waiting = [(run, 1) for run in reversed(runs)]
    while waiting:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, context, end_with_driver) as executor:
            flying: dict[Future[Row], tuple[Run, int]] = {}
            try:
                while waiting or flying:
                    while waiting and len(flying) < AHEAD * workers:
                        run, tries = waiting.pop()
                        future = executor.submit(attempt, run.model_dump(mode="json"))
                        flying[future] = (run, tries)
                    done, _ = wait(flying, return_when=FIRST_COMPLETED)
                    for future in done:
                        yield future.result()
                        del flying[future]
            except KeyboardInterrupt:
                executor.shutdown(wait=False, cancel_futures=True)
                raise
            except BrokenProcessPool:
                for future, (run, tries) in flying.items():
                    row = _finished(future)
                    if row is not None:
                        yield row
                    elif tries >= MOST_ATTEMPTS:
                        yield _dead(run)
                    else:
                        waiting.append((run, tries + 1))


def _finished(future: Future[Row]) -> Row | None:
    if not future.done() or future.cancelled() or future.exception() is not None:
        return None
    return future.result()


def _dead(run: Run) -> Row:
    """Return the row of a run that took its worker along every time."""
    text = f"the worker died {MOST_ATTEMPTS} times"
    return {
        "key": run.key,
        "seed": run.seed,
        "scenario": run.scenario,
        "noise": run.noise,
        "trajectory": "" if run.trajectory is None else str(run.trajectory),
        "status": "FAILED",
        "traceback": text,
        "wall_s": 0.0,
    }


def on_dask(runs: Sequence[Run], address: str) -> Iterator[Row]:
    """Yield rows as they come from the cluster; it does a lost worker's runs again itself.

    Its workers must have this software and one thread per library, as `local` sets it.

    Raises
    ------
    ScenarioError when there is no scheduler.
    """
    from distributed import Client, as_completed

    by_key = {run.key: run for run in runs}
    try:
        client = Client(address)
    except (OSError, ValueError) as error:
        raise ScenarioError(f"--scheduler {address}: {error}") from error
    with client:
        futures = [
            client.submit(attempt, run.model_dump(mode="json"), key=f"run-{key}", pure=False)
            for key, run in by_key.items()
        ]
        for future in as_completed(futures):
            if future.status == "finished":
                yield future.result()
            else:
                yield _dead(by_key[str(future.key).removeprefix("run-")])
