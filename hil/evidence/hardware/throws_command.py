"""`hil hardware --throws`: recorded throws through `fsw import` and `fsw identify`, beside truth.

The wheel's inertia, in proportion to which all is found, and the device's own inertia come from the
throws of calibration, as in the owners' tool; what is judged is the body without the device.
"""

from __future__ import annotations

import json
import sys
import tempfile
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console
from rich.table import Table

from fsw.__main__ import main as fsw
from hil.evidence.hardware import throws
from hil.evidence.hardware.data_set import DataError
from hil.evidence.hardware.throws import THROWS, Body, FloatArray, moved

FAILED_EXIT, WRONG_EXIT = 1, 2
SCALE_SIGMA_RATIO = 0.005  # of the calibration: what it leaves of the proof body
FIRST_KG_M2 = {"device_only": 1e-4, "proof_body": 5e-4, "config_empty": 6e-4}
FIRST_KG_M2 |= {"config_a": 2e-3, "config_b": 1.2e-3, "config_c": 3e-3}
URDF = """<robot name="thrown"><link name="body"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>
"""
MAPPING = {
    "time": {"column": "t", "unit": "s"},
    "imu": {
        "rate": {"columns": "w{}", "unit": "rad/s"},
        "specific_force": {"columns": "f{}", "unit": "m/s2"},
    },
    "wheels": {
        "time": {"column": "t_wheel", "unit": "s"},
        "speed": {"columns": "speed", "unit": "rad/s"},
    },
}


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    name: str
    status: str
    mean: FloatArray  # (10,) mass, its moments, inertia xx xy yy xz yz zz about the unit; or empty
    covariance: FloatArray  # (10, 10)


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """One set of throws."""

    name: str
    throws: int
    found: int
    valid: int
    mean_percent: float  # error of the principal moments over their norm
    worst_percent: float
    nees: float  # of the three moments, mean; 3 where sigma is right
    nees_median: float


def run(data: Path, *, fetch: bool, out: Path | None, as_json: bool) -> int:
    """Judge every set; return the exit code."""
    progress = Console(stderr=True)
    with ExitStack() as stack:
        if out is None:
            out = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hil-throws-")))
        out.mkdir(parents=True, exist_ok=True)
        (out / "body.urdf").write_text(URDF, encoding="utf-8")
        (out / "mapping.yaml").write_text(yaml.safe_dump(MAPPING), encoding="utf-8")
        sets: dict[str, list[_Found]] = {}
        try:
            if fetch:
                THROWS.fetch(data, progress.print)
            for path in THROWS.files:
                name = path.split("/")[2]
                progress.print(f"{name}: {Path(path).stem}")
                sets.setdefault(name, []).append(_found(data, out, path, name))
        except DataError as error:
            sys.stderr.write(f"{error}\n")
            return WRONG_EXIT
    results = _judged(sets)
    if as_json:
        sys.stdout.write(json.dumps([asdict(result) for result in results]) + "\n")
    else:
        _print(results)
    passed = all(
        r.found == r.throws and r.mean_percent <= throws.PUBLISHED[r.name][0] for r in results
    )
    return 0 if passed else FAILED_EXIT


def _mass_kg(name: str) -> float:
    other = {"device_only": 0.0, "proof_body": throws.PROOF_KG}
    if name in other:
        return throws.DEVICE_KG + other[name]
    return throws.DEVICE_KG + throws.frame_with_blocks(throws.SETS[name]).mass_kg


def _found(data: Path, out: Path, path: str, name: str) -> _Found:
    """Import and identify one throw."""
    stem = Path(path).stem
    throws.write_csv(THROWS.read(data, path), out / f"{stem}.csv")
    document = yaml.safe_load(Path(__file__).with_name("throws.yaml").read_text(encoding="utf-8"))
    base, first = document["bodies"]["base"], FIRST_KG_M2[name]
    base["mass_kg"] = _mass_kg(name)
    base["inertia_kg_m2"] = [first, 0.0, 0.0, first, 0.0, first]
    base["sigma"]["inertia_kg_m2"] = [5.0 * first] * 6
    config, recording = out / f"{name}.yaml", out / f"{stem}.mcap"
    config.write_text(yaml.safe_dump(document), encoding="utf-8")
    recording.unlink(missing_ok=True)
    mapped = ("import", str(out / f"{stem}.csv"), "--map", str(out / "mapping.yaml"))
    said = _fsw(*mapped, "--config", str(config), "--out", str(recording))
    said = _fsw("identify", str(recording), "--method", "mrnea", "--json") or said
    if not said.startswith("{"):
        return _Found(stem, said or "no result", np.empty(0), np.empty((0, 0)))
    values: dict[str, Any] = json.loads(said)
    P = np.array(values["covariance"])[:10, :10]
    return _Found(stem, values["status"], np.array(values["mean"][:10]), P)


def _fsw(*arguments: str) -> str:
    """Return what a command prints, or its last line of complaint."""
    said, wrong = StringIO(), StringIO()
    with redirect_stdout(said), redirect_stderr(wrong):
        code = fsw(list(arguments))
    last = wrong.getvalue().strip().splitlines()[-1:] if code and not said.getvalue() else []
    return said.getvalue() or "".join(last)


def _central(mean: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return inertia (3, 3) about the centre of mass, and where that is (3,)."""
    mass, c = mean[0], mean[1:4] / mean[0]
    xx, xy, yy, xz, yz, zz = mean[4:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - moved(mass, c), c


def _judged(sets: dict[str, list[_Found]]) -> list[Result]:
    device, proof = (
        np.mean([f.mean for f in sets[name] if f.mean.size], axis=0)
        for name in ("device_only", "proof_body")
    )
    (I_device, c_device), (I_proof, c_proof) = _central(device), _central(proof)
    added = _with_device(throws.proof_body(), c_device, c_proof)
    gained = I_proof - I_device
    scale = float(np.sum(added * gained) / np.sum(gained * gained))

    def moments(mean: FloatArray, body: Body) -> FloatArray:
        inertia, c = _central(mean)
        shifts = _with_device(Body(body.mass_kg, np.zeros((3, 3))), c_device, c)
        return np.asarray(np.linalg.eigvalsh(scale * (inertia - I_device) - shifts))

    results = []
    for name, places in throws.SETS.items():
        body, errors, squares = throws.frame_with_blocks(places), [], []
        truth = np.linalg.eigvalsh(body.inertia_kg_m2)
        for found in sets[name]:
            if not found.mean.size:
                continue
            off = moments(found.mean, body) - truth
            steps = np.sqrt(np.diag(found.covariance)) * 1e-2
            slopes = [
                (moments(found.mean + d, body) - moments(found.mean - d, body)) / (2.0 * step)
                for d, step in zip(np.diag(steps), steps, strict=True)
            ]
            G, doubt = np.array(slopes).T, SCALE_SIGMA_RATIO * truth
            covariance = G @ found.covariance @ G.T + np.outer(doubt, doubt)
            errors.append(100.0 * float(np.linalg.norm(off) / np.linalg.norm(truth)))
            squares.append(float(off @ np.linalg.solve(covariance, off)))
        results.append(
            Result(
                name=name,
                throws=len(sets[name]),
                found=len(errors),
                valid=sum(found.status == "OK" for found in sets[name]),
                mean_percent=float(np.mean(errors)),
                worst_percent=float(np.max(errors)),
                nees=float(np.mean(squares)),
                nees_median=float(np.median(squares)),
            )
        )
    return results


def _with_device(body: Body, c_device: FloatArray, c_both: FloatArray) -> FloatArray:
    """Return what a body adds (3, 3) to the inertia of the device it is joined to."""
    s = c_device - c_both
    r = throws.DEVICE_KG / body.mass_kg * s
    return body.inertia_kg_m2 + moved(body.mass_kg, r) + moved(throws.DEVICE_KG, s)


def _print(results: list[Result]) -> None:
    table = Table(title="thrown bodies: error of the principal moments, %")
    for title in ("set", "throws", "found", "valid", "mean", "worst", "the owners' tool", "NEES"):
        table.add_column(title, justify="left" if title == "set" else "right")
    for r in results:
        mean, worst = throws.PUBLISHED[r.name]
        figures = (f"{r.mean_percent:.2f}", f"{r.worst_percent:.2f}", f"{mean:.2f} / {worst:.2f}")
        nees = f"{r.nees:.1f}, median {r.nees_median:.1f}"
        counts = (str(r.throws), str(r.found), str(r.valid))
        table.add_row(r.name, *counts, *figures, nees)
    console = Console()
    console.width = max(console.width, 120)
    console.print(table)
    console.print(
        "NEES of the three moments of a throw, 3 where sigma is right; the truth is in doubt by "
        f"{SCALE_SIGMA_RATIO:.1%} (calibration).\n{THROWS.what}; github.com/{THROWS.repository} at "
        f"{THROWS.commit[:7]}, {THROWS.licence}"
    )
