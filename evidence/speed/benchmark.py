"""Speed of identification beside peers, as ratios of one run.

Ours begins at the bytes of a recording and ends at the result. Peers get the same motion's samples
already decoded. Bounds, fixed before measuring: the whole of `fsw identify --method rda` of 60 s at
500 Hz times 7 joints at most 2 times a preallocated Pinocchio regressor loop with `lstsq` over the
30 000 samples, imports left out on both sides; the online estimation of base and target in the
daemon itself, conditioning included, at most 15 regressor calls per 500 Hz sample. Processor
time. Peers that are not installed are named.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: one core

import numpy as np

from evidence.methods.exact import true_robot
from evidence.speed import peers
from evidence.speed.peers import Samples
from fsw.config import load
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray, Window
from hil.options import seed
from hil.run.bench import VirtualRun, prepare, run_virtual
from hil.run.processes import tied
from hil.run.progress import Quiet
from hil.world.scenario import load as load_scenario
from hil.world.spline import JointSpline
from hil.world.truth import simulate
from offline.identify import identify

RATE_HZ = 500.0
SCENARIO = "target_leo"  # scenario whose recording is identified
FLIGHT = "both"  # scenario whose online estimation is measured
METHOD = "rda"
PEER_IMPORTS = "import time; import numpy, pinocchio; print(time.process_time())"


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedRatio:
    """The result of one comparison; without a bound (None) it is only printed."""

    name: str
    value: float
    bound: float | None

    @property
    def ok(self) -> bool:
        """Whether the value is within its bound, or has no bound."""
        return self.bound is None or self.value <= self.bound

    def line(self) -> str:
        """Return the comparison as one line of text."""
        if self.bound is None:
            return f"        {self.name}: {self.value:.3g}"
        word = "ok" if self.ok else "MISSED"
        return f"{word:8}{self.name}: {self.value:.3g} (<= {self.bound:g})"


def record(folder: Path, seed: int) -> tuple[Path, Path]:
    """Simulate the scenario's motion of 60 s and its rests; return recording and configuration."""
    setup = prepare(load_scenario(SCENARIO), seed, folder)
    run_virtual(setup, Quiet(), record=True)
    return next(folder.rglob("*.mcap")), setup.config_path


def motion() -> Samples:
    """Return the 30 000 samples of the same motion as decoded arrays without noise."""
    scenario = load_scenario(SCENARIO)
    spline = JointSpline.load(scenario.identification)
    history = simulate(true_robot(scenario), spline, 0.0, spline.duration_s, dt_s=0.02)
    s = history.at(np.arange(round(spline.duration_s * RATE_HZ)) / RATE_HZ)
    a = np.concatenate([s.a_NB_B, s.wd_NB_B, s.qdd], axis=1)
    return Samples(q=s.q, qd=s.qd, w_NB_B=s.w_NB_B, a=a, tau=s.tau)


def seconds(function: Callable[[], object], repeats: int) -> float:
    """Return the shortest processor time of `repeats` calls [s]."""
    best = float("inf")
    for _ in range(repeats):
        start = time.process_time()
        function()
        best = min(best, time.process_time() - start)
    return best


def regressor_loop(problem: Problem, samples: Samples) -> FloatArray:
    """Return the stacked reduced regressor from a Pinocchio loop; last column: right-hand side."""
    model, n = problem.model, samples.tau.shape[1]
    rows = np.empty((len(samples.q), 6 + n, problem.U.shape[1] + 1))
    for i in range(len(samples.q)):
        Y = model.regressor(samples.q[i], samples.w_NB_B[i], samples.qd[i], samples.a[i])
        rows[i, :, :-1] = Y @ problem.U
        rows[i, :, -1] = -Y @ problem.pi_known
    rows[:, 6:, -1] += samples.tau
    return rows.reshape(-1, rows.shape[2])


def bare_loop(problem: Problem, samples: Samples) -> None:
    """Evaluate Pinocchio's regressor at every sample and discard the results."""
    for i in range(len(samples.q)):
        problem.model.regressor(samples.q[i], samples.w_NB_B[i], samples.qd[i], samples.a[i])


def least_squares(problem: Problem, samples: Samples) -> FloatArray:
    """Return the solution of the paper's MRNEA over all samples: the peer of `identify`."""
    rows = regressor_loop(problem, samples)
    return np.asarray(np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=None)[0])


def compare_identify(
    recording: Path, config_path: Path, problem: Problem, samples: Samples
) -> list[SpeedRatio]:
    """Compare the time from bytes to result with the peer's, without and with their imports."""
    config = load(config_path)
    own_s = seconds(partial(identify, recording, config, METHOD, ()), 2)
    peer_s = seconds(partial(least_squares, problem, samples), 2)
    arguments = ("identify", str(recording), "--config", str(config_path), "--method", METHOD)
    before = os.times()
    subprocess.run(
        tied((sys.executable, "-m", "fsw", *arguments)), check=True, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    after = os.times()
    whole_s = after.children_user - before.children_user
    whole_s += after.children_system - before.children_system
    imports = subprocess.run(
        (sys.executable, "-c", PEER_IMPORTS), check=True, capture_output=True, text=True
    )
    name = f"identify --method {METHOD}, bytes to result"
    return [
        SpeedRatio(name=f"{name} / pinocchio loop + lstsq", value=own_s / peer_s, bound=2.0),
        SpeedRatio(
            name="  with the imports of both",
            value=whole_s / (peer_s + float(imports.stdout)),
            bound=None,
        ),
        SpeedRatio(name="  bytes to result [s]", value=own_s, bound=None),
        SpeedRatio(name="  pinocchio loop + lstsq [s]", value=peer_s, bound=None),
    ]


def compare_online(problem: Problem, samples: Samples, seed: int) -> list[SpeedRatio]:
    """Compare the daemon's estimation of both bodies over a flight with regressor calls."""
    few = samples.first(peers.REGRESSOR_SAMPLES)

    def call_s() -> float:
        return seconds(lambda: bare_loop(problem, few), 3) / len(few.q)

    before_s = call_s()
    windows_s, ticks = estimation_s(seed)
    call = 0.5 * (before_s + call_s())
    name = "online estimation per 500 Hz sample"
    return [
        SpeedRatio(
            name=f"{name} / regressor call",
            value=sum(windows_s) / ticks / call,
            bound=15.0,
        ),
        SpeedRatio(
            name="  longest window / regressor call",
            value=max(windows_s) / call,
            bound=None,
        ),
    ]


def estimation_s(seed: int) -> tuple[list[float], int]:
    """Return the processor time of every window of a flight [s], and the number of its ticks."""
    spent: list[float] = []
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        run = VirtualRun(prepare(load_scenario(FLIGHT), seed, Path(folder)), record=False)
        work_off = run.daemon.estimation.work_off

        def timed(window: Window) -> None:
            began_s = time.process_time()
            work_off(window)
            spent.append(time.process_time() - began_s)

        run.daemon.estimation.work_off = timed  # type: ignore[method-assign]
        run.advance(run.setup.total_s, Quiet())
        return spent, run.daemon.executive.slips.ticks


def compare_peers(problem: Problem, samples: Samples, urdf: Path) -> list[str]:
    """Compare regressors with Pinocchio's and recursions with ours; return lines of text."""
    few = samples.first(peers.REGRESSOR_SAMPLES)
    loop_s = seconds(partial(bare_loop, problem, few), 3)
    found = peers.idyntree(problem, few, str(urdf), loop_s, seconds)
    found += peers.figaroh(problem, few, loop_s, seconds)
    height = 6 + samples.tau.shape[1]
    found += peers.recursions(regressor_loop(problem, few), height, seconds)
    return [
        outcome
        if isinstance(outcome, str)
        else SpeedRatio(name=outcome[0], value=outcome[1], bound=outcome[2]).line()
        for outcome in found
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print every ratio when it is measured; return 0 if all are within their bounds, else 1."""
    parser = argparse.ArgumentParser(prog="python -m evidence.speed.benchmark", description=__doc__)
    parser.add_argument("--seed", type=seed, default=0)
    options = parser.parse_args(arguments)
    samples = motion()
    with tempfile.TemporaryDirectory(prefix="benchmark-") as folder:
        _print(["flying the motion that is to be identified"])
        recording, config_path = record(Path(folder), options.seed)
        config = load(config_path)
        urdf = config.resolve(config.robot.urdf)
        problem = build_problem(config, RobotModel(urdf, config.robot.tool_frame))
        parts: list[Callable[[], list[SpeedRatio]]] = [
            lambda: compare_identify(recording, config_path, problem, samples),
            lambda: compare_online(problem, samples, options.seed),
        ]
        kept = True
        for part in parts:
            ratios = part()
            kept = kept and all(ratio.ok for ratio in ratios)
            _print([ratio.line() for ratio in ratios])
        _print(compare_peers(problem, samples, urdf))
    return 0 if kept else 1


def _print(lines: list[str]) -> None:
    sys.stdout.write("\n".join(lines) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    raise SystemExit(main())
