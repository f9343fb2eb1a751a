"""`hil vs-basilisk`: simulate scenarios with Basilisk, compare with MuJoCo, run the daemon."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.options import count, count_or_none

if TYPE_CHECKING:
    from hil.world.history import FloatArray, TruthHistory
    from hil.world.scenario import Scenario
    from hil.world.thrusters import ThrusterSystem

SCENARIOS = (
    "target_leo",
    "base",
    "both",
    "two_arms",
    "wheels_leo",
    "base_slosh",
    "panel_leo",
    "mev",
)
ENVIRONMENT = Path(sys.prefix) / "basilisk"
PACKAGES = ("bsk==2.12.1", "numpy>=2,<3")  # other dependencies of bsk: pictures, orbits
KINK_S = 4e-3  # interpolation of a truth smears a kink over this time
ENGINE = Path(__file__).with_name("engine.py")
# Largest allowed difference of the two truths: below a hundredth of one sample's noise. The
# conserved momentum may drift by 1e-7.
BOUNDS: Mapping[str, float] = {
    "joint angle [rad]": 1e-6,
    "joint rate [rad/s]": 1e-5,
    "joint torque [N m]": 5e-4,
    "base rate [rad/s]": 1e-5,
    "attitude [rad]": 1e-6,
    "acceleration [m/s2]": 1e-4,
    "wheel speed [rad/s]": 1e-4,
    "momentum drift [N m s]": 1e-7,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flown:
    """Basilisk's truth; for each quantity the largest difference from MuJoCo, and largest value."""

    truth: TruthHistory
    apart: Mapping[str, tuple[float, float]]

    @property
    def beyond(self) -> list[str]:
        """Return the quantities whose difference exceeds BOUNDS or is not a number."""
        return [name for name, (off, _) in self.apart.items() if not off <= BOUNDS[name]]


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand `vs-basilisk`."""
    parser = commands.add_parser(
        "vs-basilisk",
        help="a second truth: Basilisk simulates scenarios for the daemon, compared with MuJoCo",
        description="Basilisk flies each scenario under the torques of MuJoCo's flight. Prints how"
        " far the two are apart; then the daemon estimates from the bytes of Basilisk's truth, and"
        " every run must be valid and the mean NEES in its 99 % band. Without a scenario all are"
        " flown, panel_leo among them: give one where that takes too long.",
    )
    parser.add_argument(
        "scenario", nargs="*", metavar="SCENARIO", help=f"{', '.join(SCENARIOS)} if none is named"
    )
    parser.add_argument(
        "--seeds", type=count_or_none, default=3, metavar="N", help="of each, 3; 0: no runs"
    )
    parser.add_argument("--jobs", type=count, default=1, metavar="N", help="runs at a time, 1")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep truths and outcomes; resume")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--env", type=Path, default=ENVIRONMENT, metavar="DIR", help=f"{ENVIRONMENT} if not given"
    )
    parser.add_argument(
        "--make-env", action="store_true", help="make that environment first (0.4 GB, from PyPI)"
    )
    parser.set_defaults(command=_vs_basilisk)


def make_environment(folder: Path) -> None:
    """Make a virtual environment with Basilisk. Raises ScenarioError if that fails."""
    from hil.world.scenario import ScenarioError

    # Basilisk has 3000 modules, of which a flight imports few
    options = ["-q", "--no-deps", "--no-compile"]
    pip = [str(folder / "bin" / "python"), "-m", "pip", "install", *options, *PACKAGES]
    for command in ([sys.executable, "-m", "venv", str(folder)], pip):
        if subprocess.run(command, check=False, stdout=sys.stderr).returncode != 0:
            raise ScenarioError(f"--make-env: failed: {' '.join(command)}")


def fly(scenario: Scenario, environment: Path) -> Flown:
    """Simulate a scenario with both engines and compare them.

    Raises
    ------
    ScenarioError if Basilisk is not installed, fails, or cannot simulate the scenario.
    """
    import numpy as np

    from hil.basilisk.craft import STEP_S, job_of, on_lines, truth_of
    from hil.run import bench
    from hil.world.scenario import ScenarioError
    from hil.world.spline import JointSpline

    python = environment / "bin" / "python"
    if not python.exists():
        raise ScenarioError(
            f"{environment}: no environment with Basilisk: hil vs-basilisk --make-env"
        )
    lines = on_lines(scenario)
    robot = bench.robot_of(lines)
    dt_s = STEP_S / 4 if lines.thrusters is not None else bench.STEP_S
    plan = bench.truth_of(lines, robot, JointSpline.load(lines.identification), dt_s)
    job = job_of(lines, robot, plan)
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        files = [Path(folder) / name for name in ("job.npz", "out.npz")]
        np.savez(files[0], **job)
        done = subprocess.run(
            [python, "-I", ENGINE, *files], capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            raise ScenarioError(f"{scenario.name}: Basilisk failed: {done.stderr[-500:]}")
        with np.load(files[1]) as stored:
            flown = dict(stored)
    truth = truth_of(job, flown, plan.start_s)
    return Flown(truth=truth, apart=_apart(plan, truth, flown["momentum_nms"], lines.thrusters))


def _apart(
    plan: TruthHistory, truth: TruthHistory, momentum_nms: FloatArray, jets: ThrusterSystem | None
) -> dict[str, tuple[float, float]]:
    """Return for each quantity the largest difference over all nodes, and the largest value.

    Torque and acceleration have a kink where a valve's force begins or ends. Times within KINK_S
    of a kink are left out of both.
    """
    import numpy as np

    times = truth.t_s[truth.t_s <= plan.end_s]
    a, b = plan.at(times), truth.at(times)
    quiet = np.full(len(times), True)
    edges = (
        []
        if jets is None
        else [p.on_s + t + jets.delay_s for p in jets.pulses for t in (0, p.for_s)]
    )
    for edge in edges:
        quiet &= np.abs(times - edge) > KINK_S
    turned = np.einsum("kji,kjl->kil", a.R_NB, b.R_NB) - np.eye(3)
    pairs = {
        "joint angle [rad]": (a.q, b.q),
        "joint rate [rad/s]": (a.qd, b.qd),
        "joint torque [N m]": (a.tau[quiet], b.tau[quiet]),
        "base rate [rad/s]": (a.w_NB_B, b.w_NB_B),
        "acceleration [m/s2]": (a.a_NB_B[quiet], b.a_NB_B[quiet]),
    }
    if plan.wheel_rad_s is not None:
        c, d = (np.array([k.wheels_at(t)[0] for t in times[::50]]) for k in (plan, truth))
        pairs["wheel speed [rad/s]"] = (c, d)
    apart = {
        name: (float(np.abs(x - y).max()), float(np.abs(x).max())) for name, (x, y) in pairs.items()
    }
    whole = np.abs(a.R_NB - a.R_NB[0]).max()
    apart["attitude [rad]"] = float(np.abs(turned).max()), float(whole)
    if jets is None:
        drift = np.abs(momentum_nms - momentum_nms[0]).max()
        apart["momentum drift [N m s]"] = float(drift), float(np.abs(momentum_nms).max())
    return apart


def _vs_basilisk(arguments: argparse.Namespace) -> int:
    from hil.errors import make_folder
    from hil.world.scenario import load

    if arguments.make_env:
        make_environment(arguments.env)
        if not arguments.scenario:
            return 0
    found, failed = {}, False
    with tempfile.TemporaryDirectory(prefix="hil-") as scratch:
        folder = (arguments.out or Path(scratch)).absolute()
        make_folder(folder)
        for name in arguments.scenario or SCENARIOS:
            scenario = load(name)
            flown = fly(scenario, arguments.env)
            file = folder / f"{scenario.name}.npz"
            flown.truth.save(file, scenario.name)
            found[name] = {"apart": flown.apart, "beyond": flown.beyond}
            failed |= bool(flown.beyond)
            if not arguments.json:
                _show(name, flown)
            if arguments.seeds:
                summary = _estimate(name, file, arguments)
                low, high = summary["nees_band_99"]
                failed |= summary["valid"] < summary["seeds"]
                failed |= not low <= summary["mean_nees"] <= high
                found[name]["estimate"] = summary
    if arguments.json:
        print(json.dumps(found))
    return 1 if failed else 0


def _estimate(name: str, file: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    """Run the daemon on device bytes of the truth in `file`; return the summary of all seeds."""
    from rich.console import Console

    from evidence.seeds import run_seeds, show, summary

    options = ["--fast", "--truth", str(file)]
    out = None if arguments.out is None else file.with_suffix("")
    outcomes = run_seeds(name, range(arguments.seeds), arguments.jobs, options, out)
    if not arguments.json:
        show(outcomes, Console(width=120))
    return summary(outcomes)


def _show(name: str, flown: Flown) -> None:
    """Print the largest differences of the two truths next to the largest values."""
    print(f"{name}: Basilisk and MuJoCo, largest difference, and of what")
    for quantity, (off, size) in flown.apart.items():
        mark = "  BEYOND" if quantity in flown.beyond else ""
        print(f"  {quantity:24s} {off:9.2e} (at most {BOUNDS[quantity]:.0e})  of {size:.3g}{mark}")
