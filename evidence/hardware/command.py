"""`hil hardware`: real arms with a known payload, through `fsw import` and `fsw identify`.

Each arm is one declaration (`arms.Arm`). Its runs are identified with the configuration that
`fsw init` wrote and with what its owner would add, alone and against an empty run.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

import numpy as np
import yaml
from rich.console import Console

from evidence.hardware import robots, throws_command
from evidence.hardware.arms import Arm
from evidence.hardware.data_set import DataError, DataSet
from evidence.hardware.judge import (
    EMPTY_SIGMAS,
    LOADED_SIGMAS,
    NEES_BOUND,
    SIGMA_RATIO,
    Case,
    Result,
    judged,
)
from evidence.hardware.prepared import import_motion, prepare
from evidence.store import results_in
from evidence.terminal import print_table

FAILED_EXIT, WRONG_EXIT = 1, 2


def declared() -> dict[str, Arm]:
    """Return the arms that the modules in `robots` declare, by name."""
    modules = [
        import_module(f"{robots.__name__}.{found.name}") for found in iter_modules(robots.__path__)
    ]
    return {arm.name: arm for module in modules for arm in module.ARMS}


def run(
    data: Path,
    *,
    throws: bool,
    fetch: bool,
    out: Path | None,
    as_json: bool,
    arms: Sequence[str] = (),
    held_out: bool = False,
    repositories: Sequence[Path] = (),
) -> int:
    """Judge the arms, or the throws; return 0, 1 if a result failed, or 2 without the data."""
    if throws:
        return throws_command.run(data, fetch=fetch, out=out, as_json=as_json)
    progress = Console(stderr=True)
    results: list[Result] = []
    try:
        chosen = _chosen(arms)
        with results_in(out) as folder:
            for arm in chosen:
                if fetch:
                    for data_set in arm.data_sets:
                        data_set.fetch(data, progress.print, repositories)
                results += _with_ratios(
                    list(_judged(arm, data, folder / arm.name, progress, held_out=held_out))
                )
    except DataError as error:
        sys.stderr.write(f"{error}\n")
        return WRONG_EXIT
    if as_json:
        rows = [asdict(result) | {"z": result.z, "verdict": result.verdict} for result in results]
        sys.stdout.write(json.dumps(rows) + "\n")
    else:
        _print(results, chosen)
    return 0 if all(result.passed for result in results) else FAILED_EXIT


def _chosen(names: Sequence[str]) -> list[Arm]:
    known = declared()
    for name in names:
        if name not in known:
            raise DataError(f"--arm {name}: must be one of {', '.join(known)}")
    return [known[name] for name in names or known]


def _judged(
    arm: Arm, data: Path, folder: Path, progress: Console, *, held_out: bool
) -> Iterator[Result]:
    """Yield the results of all cases of an arm, with its runs imported into a folder."""

    def read(data_set: DataSet, path: str) -> bytes:
        return data_set.read(data, path).read_bytes()

    config = prepare(arm, read, folder)
    overlay = folder / "best.yaml"
    overlay.write_text(yaml.safe_dump(dict(arm.overlay), sort_keys=False), encoding="utf-8")
    runs = [run for run in arm.runs if held_out or not run.held_out]
    recordings: dict[str, Path] = {}
    for run in runs:
        progress.print(f"{arm.name}: importing {run.name}")
        recordings[run.name] = import_motion(arm, run.motion(read), config, folder / run.name)
    for configuration in ("naive", "best") if arm.overlay else ("naive",):
        best = overlay if configuration == "best" else None
        for run in runs:
            alone = [None] if run.alone else []
            for reference in [*alone, run.empty] if run.empty else alone:
                case = Case(arm=arm, run=run, configuration=configuration, reference=reference)
                progress.print(f"{case.name}: identifying")
                yield judged(case, recordings, config, best)


def _with_ratios(results: Sequence[Result]) -> list[Result]:
    """Return the results with their sigma over that of the same case's best configuration."""
    best = {
        result.case.removesuffix("best"): result.mass_sigma_kg
        for result in results
        if result.configuration == "best"
    }
    return [
        replace(
            result,
            sigma_ratio=result.mass_sigma_kg
            / best.get(result.case.removesuffix(result.configuration), float("nan")),
        )
        for result in results
    ]


def _print(results: Sequence[Result], arms: Sequence[Arm]) -> None:
    print_table(
        "recorded arms, identified",
        (
            *("case", "true [kg]", "mass [kg]", "z", "status", "claim on mass"),
            *("held out", "sigma ratio", "verdict"),
        ),
        [_line(result) for result in results],
        170,
        f"ok: of use, within {EMPTY_SIGMAS:g} sigma of an empty flange or {LOADED_SIGMAS:g} of a"
        f" payload, NEES of an empty flange at most {NEES_BOUND:.1f} (ten parameters, 99 %)."
        " refused: the mass is not claimed. WRONG: claimed, and beyond"
        f" {LOADED_SIGMAS:g} sigma. Held out: windows that were not used, as fsw identify judges"
        f" them. Sigma ratio: over the best configuration's, at most {SIGMA_RATIO:g}."
        " *: a run that was used for nothing before.",
        *(
            f"{own.what}; github.com/{own.repository} at {own.commit[:7]}, {own.licence}"
            for arm in arms
            for own in arm.data_sets
        ),
    )


def _line(result: Result) -> list[str]:
    mass = z = held = ratio = ""
    if np.isfinite(result.mass_kg):
        mass = f"{result.mass_kg:.3f} +- {result.mass_sigma_kg:.3f}"
        nees = f", NEES {result.nees:.1f}" if np.isfinite(result.nees) else ""
        z = f"{result.z:.1f}{nees}"
        word = "passed" if result.held_out_windows_passed else "failed"
        held = f"{word}, {result.residual_nm:.2g} N m"
    if np.isfinite(result.sigma_ratio):
        ratio = f"{result.sigma_ratio:.2f}"
    star = " *" if result.held_out else ""
    payload = f"{result.payload_kg:g}"
    return [
        *(result.case + star, payload, mass, z, result.status, result.claim),
        *(held, ratio, result.verdict),
    ]
