"""Run cases in this process, in several processes of this machine, or on a Dask cluster."""

import multiprocessing
import os
import pickle
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from hil.run.processes import end_with, end_with_driver
from hil.world.scenario import ScenarioError

MOST_ATTEMPTS = 3  # attempts of a case whose process dies
AHEAD = 4  # cases handed out per process: few, because all of them run again if a process dies
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

C = TypeVar("C")
R = TypeVar("R")


class CaseLostError(RuntimeError):
    """A process died in every attempt of a case."""


def forked(name: str, work: Callable[[], R]) -> R:
    """Return the result of named work in a copy of this process, which ends as if it were killed.

    Raises
    ------
    RuntimeError if the copy ends without a result; it has printed why.
    """
    read_fd, write_fd = os.pipe()
    parent, child = os.getpid(), os.fork()
    if child == 0:
        status = 1
        try:
            end_with(parent)
            os.close(read_fd)
            with os.fdopen(write_fd, "wb") as pipe:
                pickle.dump(work(), pipe)
            status = 0
        finally:
            if status:
                traceback.print_exc()
            os._exit(status)
    os.close(write_fd)
    with os.fdopen(read_fd, "rb") as pipe:
        data = pipe.read()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code:
        raise RuntimeError(f"{name} ended with {code}")
    result: R = pickle.loads(data)
    return result


def one_by_one(work: Callable[[C], R], cases: Sequence[C]) -> Iterator[tuple[C, R]]:
    """Run the cases one after the other in this process; yield each case with its result."""
    for case in cases:
        yield case, work(case)


def run(work: Callable[[C], R], cases: Sequence[C], jobs: int) -> Iterator[tuple[C, R]]:
    """Yield each case with its result; one job or one case runs in this process."""
    if jobs <= 1 or len(cases) <= 1:
        return one_by_one(work, cases)
    return over_processes(work, cases, jobs)


def over_processes(
    work: Callable[[C], R],
    cases: Sequence[C],
    jobs: int,
    *,
    lost: Callable[[C, str], R] | None = None,
    single: bool = False,
) -> Iterator[tuple[C, R]]:
    """Yield each case with its result, in the order in which the cases finish.

    If a process dies, new processes start, and all unfinished cases that were handed out run again.
    The processes end when this process ends or is interrupted. Their libraries use one thread.

    Parameters
    ----------
    work : importable function of a picklable case
    jobs : number of processes at a time
    lost : returns a result for a case of which every attempt failed, from the case and the reason
    single : whether every case gets a new process

    Raises
    ------
    CaseLostError if every attempt of a case failed and `lost` is None; errors of `work`.
    """
    for name in ONE_THREAD:  # new processes read these variables before their libraries start
        os.environ[name] = "1"
    waiting = [(case, 1) for case in reversed(cases)]
    others = set(multiprocessing.active_children())
    while waiting:
        flying: dict[Future[R], tuple[C, int]] = {}
        with _executor(jobs, single=single) as executor:
            try:
                while waiting or flying:
                    while waiting and len(flying) < (jobs if single else AHEAD * jobs):
                        case, attempt = waiting.pop()
                        flying[executor.submit(work, case)] = case, attempt
                    for future in wait(flying, return_when=FIRST_COMPLETED).done:
                        result = future.result()
                        yield flying.pop(future)[0], result
            except BrokenProcessPool:
                pass
            except BaseException:  # an interrupt too: nobody needs the cases that still run
                _kill(others)
                raise
        for future, (case, attempt) in flying.items():
            if future.done() and not future.cancelled() and future.exception() is None:
                yield case, future.result()
            elif attempt < MOST_ATTEMPTS:
                waiting.append((case, attempt + 1))
            elif lost is not None:
                yield case, lost(case, _reason())
            else:
                raise CaseLostError(f"{case}: {_reason()}")


def over_dask(
    work: Callable[[C], R],
    cases: dict[str, C],
    address: str,
    lost: Callable[[C, str], R],
) -> Iterator[tuple[C, R]]:
    """Run cases, given by key, on a Dask cluster; yield each case with its result as it finishes.

    The cluster itself runs the cases of a lost worker again; `lost` gives the result of a failed
    case. The workers must have this software, and one thread per library as in `over_processes`.

    Raises
    ------
    ScenarioError if no scheduler answers at the address.
    """
    from distributed import Client, KilledWorker, as_completed

    try:
        client = Client(address)
    except (OSError, ValueError) as error:
        raise ScenarioError(f"--scheduler {address}: {error}") from error
    with client:
        futures = [
            client.submit(work, case, key=f"run-{key}", pure=False) for key, case in cases.items()
        ]
        for future in as_completed(futures):
            case = cases[str(future.key).removeprefix("run-")]
            failure = future.exception()
            died = isinstance(failure, KilledWorker)
            words = _reason() if died else f"{type(failure).__name__}: {failure}"
            yield case, future.result() if failure is None else lost(case, words)


def _executor(jobs: int, *, single: bool) -> ProcessPoolExecutor:
    context = multiprocessing.get_context("spawn")
    most = 1 if single else None
    return ProcessPoolExecutor(jobs, context, end_with_driver, max_tasks_per_child=most)


def _kill(others: set[multiprocessing.process.BaseProcess]) -> None:
    for process in set(multiprocessing.active_children()) - others:
        process.kill()


def _reason() -> str:
    return f"the worker died {MOST_ATTEMPTS} times"
