"""One identification of a recorded arm as a user does it, and the judgement of what it claims."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from evidence.hardware.arms import Arm, Run
from evidence.hardware.prepared import fsw

HOLDOUT = "0.3"
NEES_BOUND = float(chi2.ppf(0.99, 10))
EMPTY_SIGMAS, LOADED_SIGMAS = 2.0, 3.0  # how far the mass of a claim may be off
SIGMA_RATIO = 2.0  # of `fsw init`'s configuration over the best one
MEASURED = "measured"  # the verdict of `fsw identify` on a parameter that is of use
NAN = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What is identified: a recording, with a configuration, against a reference or none."""

    arm: Arm
    run: Run
    configuration: str  # "naive": as `fsw init` wrote it; "best": with its owner's overlay
    reference: str | None = None  # name of the empty run

    @property
    def name(self) -> str:
        """Return the name of the case in the table."""
        against = f", arm of {self.reference}" if self.reference else ""
        return f"{self.arm.name} {self.run.name}{against}, {self.configuration}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The result of one identification of a known payload."""

    case: str
    configuration: str
    payload_kg: float
    held_out: bool  # the run was used for nothing before
    status: str  # of the identification, or the error message without one
    claim: str = ""  # the verdict of `fsw identify` on the mass
    note: str = ""
    mass_kg: float = NAN
    mass_sigma_kg: float = NAN
    nees: float = NAN  # of an empty flange, whose ten parameters are zero
    residual_nm: float = NAN  # rms residual of the torques in windows that were not used
    residual_bound_nm: float = NAN
    held_out_windows_passed: bool = False  # the verdict of `fsw identify --holdout`
    sigma_ratio: float = NAN  # over the sigma of the best configuration

    @property
    def z(self) -> float:
        """Return the error of the mass in its own sigmas."""
        return (self.mass_kg - self.payload_kg) / self.mass_sigma_kg

    @property
    def claimed(self) -> bool:
        """Whether `fsw identify` calls the mass measured, or an empty flange's estimate valid."""
        return self.claim == MEASURED or self.status == "OK"

    @property
    def passed(self) -> bool:
        """Whether the claim is right, the mass is valid, and held-out torques are predicted."""
        empty = self.payload_kg == 0.0
        held = np.isnan(self.residual_bound_nm) or self.residual_nm <= self.residual_bound_nm
        usable = self.status in ("OK", "INSUFFICIENT_EXCITATION") if empty else self.claimed
        return bool(
            usable
            and abs(self.z) <= (EMPTY_SIGMAS if empty else LOADED_SIGMAS)
            and held
            and not (empty and self.nees > NEES_BOUND)
        )

    @property
    def wrong(self) -> bool:
        """Whether a mass that is called of use is beyond three sigma."""
        return bool(self.claimed and not abs(self.z) <= LOADED_SIGMAS)

    @property
    def verdict(self) -> str:
        """Return the verdict in one word."""
        return "WRONG" if self.wrong else "ok" if self.passed else "refused"


def judged(case: Case, recordings: dict[str, Path], config: Path, overlay: Path | None) -> Result:
    """Identify a case twice, on all windows and with some held out, and judge it."""
    arguments = ["identify", str(recordings[case.run.name]), "--config", str(config), "--json"]
    if overlay is not None:
        arguments += ["--overlay", str(overlay)]
    if case.reference is not None:
        arguments += ["--reference", str(recordings[case.reference])]
    known: dict[str, Any] = {
        "case": case.name,
        "configuration": case.configuration,
        "payload_kg": case.run.payload_kg,
        "held_out": case.run.held_out,
        "residual_bound_nm": case.arm.residual_bound_nm,
    }
    found = fsw(*arguments)
    held = fsw(*arguments, "--holdout", HOLDOUT) if found.stdout else found
    if not held.stdout:
        said = held.stderr.strip().splitlines()
        return Result(**known, status=said[-1] if said else "no result")
    values: dict[str, Any] = json.loads(found.stdout)
    x = np.array(values["mean"][:10])
    P = np.array(values["covariance"])[:10, :10]
    empty = case.run.payload_kg == 0.0
    judgement = json.loads(held.stdout)["holdout"]
    torques = [c for c in judgement["channels"].values() if c["unit"] == "N m"]
    squares = sum(c["nodes"] * c["rms"] ** 2 for c in torques)
    return Result(
        **known,
        status=values["status"],
        claim=values["diagnosis"]["parameters"]["target"]["mass_kg"],
        note=values["note"],
        mass_kg=float(x[0]),
        mass_sigma_kg=float(np.sqrt(P[0, 0])),
        nees=float(x @ np.linalg.solve(P, x)) if empty else NAN,
        residual_nm=float(np.sqrt(squares / sum(c["nodes"] for c in torques))),
        held_out_windows_passed=judgement["passed"],
    )
