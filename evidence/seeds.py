"""Run many seeds of one scenario, each in a separate process, and summarise their outcomes."""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from evidence import runner
from evidence.settings import content_of
from evidence.store import Row, Store
from evidence.terminal import print_table
from hil.judge import chi_square
from hil.run.live import LiveError
from hil.run.processes import tied
from hil.world.scenario import load

TITLES = (
    *("seed", "body", "mass error [%]", "sigmas", "sigma/CRB", "exact motion"),
    *("NEES", "mean EE [mm]"),
)


def outcome(seed: int, scenario: str, options: Sequence[str]) -> dict[str, Row]:
    """Return the outcome of `hil run SCENARIO --json` for a seed, under the seed's text.

    Raises
    ------
    LiveError if the run printed no outcome.
    """
    command = [sys.executable, "-m", "hil", "run", scenario, "--json", "--seed", str(seed)]
    done = subprocess.run(tied([*command, *options]), capture_output=True, text=True, check=False)
    if not done.stdout.strip():
        raise LiveError(f"seed {seed} failed: {done.stderr.strip()[-500:]}")
    return {str(seed): json.loads(done.stdout)}


def run_seeds(
    scenario: str,
    seeds: Sequence[int],
    jobs: int,
    options: Sequence[str],
    out: Path | None,
    files: Mapping[str, Path] | None = None,
) -> list[Mapping[str, Any]]:
    """Run the seeds that the folder lacks; return the outcomes of all seeds in their order.

    `files`: configurations by the option that names them, beside `options`.

    Raises
    ------
    ScenarioError if the folder holds results of another scenario, other files or other options.
    """
    files = files or {}
    content = content_of(load(scenario), files)
    settings = {"options": list(options), "judged": "every output", "content": content}
    store = Store(out, settings)
    named = [word for name, path in files.items() for word in (f"--{name}", str(path))]
    work = partial(outcome, scenario=scenario, options=[*options, *named])
    return runner.rows(scenario, work, seeds, store, jobs)


def summary(outcomes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the mean NEES with its two-sided 99 % band, the mass errors by body, and counts.

    The band holds for the mean of N chi-square values of `dof` degrees of freedom.
    """
    dof, count = outcomes[0]["dof"], len(outcomes)
    low, high = chi_square.mean_ends(dof, count, 0.01)
    bodies = {}
    for body in outcomes[0]["unknown"]:
        truth = np.array([o["truth"][body]["mass_kg"] for o in outcomes])
        mass = np.array([o["estimate"][body]["mass_kg"] for o in outcomes])
        sigma = np.array([o["sigma"][body]["mass_kg"] for o in outcomes])
        ratios = [o["mass_sigma_to_crb_ratio"][body] for o in outcomes]
        efficiencies = [o["mass_sigma_to_true_crb_ratio"][body] for o in outcomes]
        bodies[body] = {
            "within_0.3_percent": int(np.sum(np.abs(mass / truth - 1) <= 0.003)),
            "within_3_sigma": int(np.sum(np.abs(mass - truth) <= 3 * sigma)),
            "worst_mass_error_ratio": float(np.abs(mass / truth - 1).max()),
            "worst_sigma_to_crb_ratio": max(ratios),
            "worst_sigma_to_true_crb_ratio": max(efficiencies),
            "mean_sigma_to_true_crb_ratio": float(np.mean(efficiencies)),
        }
    samples = [counts for o in outcomes for counts in o["samples"].values()]
    errors = [o["ee_error"]["mean_position_m"] for o in outcomes]
    return {
        "seeds": count,
        "valid": sum(o["valid"] for o in outcomes),
        "ever_valid_and_wrong": sum(o["outputs"]["wrong"] > 0 for o in outcomes),
        "mean_nees": float(np.mean([o["nees"] for o in outcomes])),
        "nees_band_99": [low, high],
        "dof": dof,
        "bodies": bodies,
        "worst_mean_ee_error_m": max(errors),
        "rejected": sum(c["rejected"] for c in samples),
        "lost": sum(c["lost"] for c in samples),
        "late": sum(c["late"] for c in samples),
        "slips": sum(o["slips"] for o in outcomes),
        "slowest_speed_ratio": min(o["simulated_s"] / o["wall_s"] for o in outcomes),
    }


def show(outcomes: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print a line for each seed and body, and the summary."""
    rows = []
    for o in outcomes:
        for body in o["unknown"]:
            truth, mass = o["truth"][body]["mass_kg"], o["estimate"][body]["mass_kg"]
            rows.append(
                [
                    *(str(o["seed"]), body, f"{100 * (mass / truth - 1):+.4f}"),
                    f"{(mass - truth) / o['sigma'][body]['mass_kg']:+.2f}",
                    f"{o['mass_sigma_to_true_crb_ratio'][body]:.2f}",
                    f"{o['mass_sigma_to_crb_ratio'][body]:.2f}",
                    *(f"{o['nees']:.1f}", f"{1e3 * o['ee_error']['mean_position_m']:.4f}"),
                ]
            )
    print_table(f"{outcomes[0]['scenario']}, {outcomes[0]['method']}", TITLES, rows, 100)
    total = summary(outcomes)
    low, high = total["nees_band_99"]
    console.print(
        f"mean NEES {total['mean_nees']:.2f} for {total['dof']} parameters; 99 % band "
        f"[{low:.2f}, {high:.2f}]; {total['valid']} of {total['seeds']} valid; "
        f"{total['ever_valid_and_wrong']} with any output that was valid and beyond 5 sigma"
    )
    for body, values in total["bodies"].items():
        console.print(f"{body}: " + ", ".join(f"{k} {v:.4g}" for k, v in values.items()))
    rest = ("worst_mean_ee_error_m", "rejected", "lost", "late", "slips", "slowest_speed_ratio")
    console.print(", ".join(f"{key} {total[key]:.4g}" for key in rest))
