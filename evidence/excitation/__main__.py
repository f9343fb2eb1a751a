"""Print every figure asked of the excitation planner: `python -m evidence.excitation`."""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: one core

from evidence.excitation import cases
from evidence.excitation.compare import Contest, contests
from evidence.excitation.gradients import criterion_error, limits_error
from evidence.excitation.requests import INFEASIBLE, refusal
from evidence.excitation.scatter import scatter
from hil.options import count
from planner import criteria, spline

PARTS = ("gradients", "requests", "contests", "scatter")
CRITERIA: tuple[criteria.Name, ...] = ("cond", "gamma", "sigma")


def main(argv: list[str] | None = None) -> int:
    """Run the requested parts; return 0."""
    parser = argparse.ArgumentParser(prog="python -m evidence.excitation", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--systems", nargs="+", choices=list(cases.SYSTEMS), default=cases.SYSTEMS)
    parser.add_argument("--runs", type=count, default=50)
    parser.add_argument("--folder", type=Path, default=Path("runs/excitation"))
    options = parser.parse_args(argv)
    parts = options.parts or PARTS
    unknown = sorted(set(parts) - set(PARTS))
    if unknown:
        parser.error(f"no such part: {unknown}; there are {PARTS}")
    options.folder.mkdir(parents=True, exist_ok=True)
    if "gradients" in parts:
        _gradients()
    if "requests" in parts:
        _requests()
    for system in options.systems:
        if "contests" in parts:
            _contests(system, options.folder)
        if "scatter" in parts:
            _scatter(system, options.folder, options.runs)
    return 0


def _gradients() -> None:
    own = cases.subject("both")
    for name in criteria.NAMES:
        _say(f"gradient of {name}: relative error {criterion_error(own, name):.1e}")
    _say(f"Jacobian of the limits: relative error {limits_error(own):.1e}")


def _requests() -> None:
    for name, changes in INFEASIBLE.items():
        error = refusal(changes)
        _say(f"{name}: {'NOT REFUSED' if error is None else error}")


def _contests(system: str, folder: Path) -> None:
    for found in contests(system, CRITERIA, _say):
        spline.save(
            found.plan.trajectory,
            folder / f"{system}_{found.criterion}.yaml",
            {"system": system, "criterion": found.criterion, "value": found.optimised},
        )
        _say(_line(found))


def _line(found: Contest) -> str:
    return (
        f"{found.system} {found.criterion}: optimised {found.optimised:.5g} in "
        f"{found.optimiser_s:.1f} s ({found.evaluations:.0f} evaluations); best of {found.randoms} "
        f"random in {found.random_s:.0f} s {found.best_random:.5g} "
        f"(x {found.best_random / found.optimised:.2f}), median {found.median_random:.5g} "
        f"(x {found.median_random / found.optimised:.2f}); dense check: worst limit "
        f"{-found.dense_excess:.4f} inside; truth: {found.truth_limit} at {found.truth.ratio:.4f}"
    )


def _scatter(system: str, folder: Path, runs: int) -> None:
    path = folder / f"{system}_sigma.yaml"
    if path.exists():
        trajectory = spline.load(path)
    else:
        trajectory = cases.planner(cases.subject(system)).plan().trajectory
    found = scatter(system, trajectory, runs, say=_say)
    low, high = found.interval
    _say(
        f"{system}: {found.runs} runs, whitened pooled ratio {found.pooled_ratio:.4f}; sums of "
        f"squares {found.chi_square.min():.1f} to {found.chi_square.max():.1f}, interval "
        f"{low:.1f} to {high:.1f}; outside: {found.outside or 'none'}; "
        f"not converged: {found.not_converged}"
    )


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
