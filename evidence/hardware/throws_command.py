"""`hil hardware --throws`: recorded throws through `fsw import` and `fsw identify`, and the truth.

The calibration throws give the gyro matrix, the device's inertia and the wheel's inertia, to which
all identified values are proportional. The body without the device is judged.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from dataclasses import asdict
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console

from evidence.hardware import throws
from evidence.hardware.data_set import DataError
from evidence.hardware.throws import THROWS
from evidence.hardware.throws_judge import Found, Result, judged
from evidence.terminal import print_table
from fsw.__main__ import main as fsw

FAILED_EXIT, WRONG_EXIT = 1, 2
CALIBRATION = ("device_only", "proof_body")
CALIBRATION_TORQUE_NM = 1.0e-4  # sigma of the air's torque on small bodies; see throws.yaml
FIRST_KG_M2 = {"device_only": 1e-4, "proof_body": 5e-4, "config_empty": 6e-4}
FIRST_KG_M2 |= {"config_a": 2e-3, "config_b": 1.2e-3, "config_c": 3e-3}
TAKEN = ("gyro_matrix", "mounting")  # used from a calibration; every throw has its own biases
SIGMAS = {  # without imu_angle.z: a rotation about the wheel's axis z changes no principal moment
    "mounting_angle_sigma_rad": ("imu_angle.x", "imu_angle.y"),
    "gyro_scale_sigma_ratio": ("gyro_scale.x", "gyro_scale.y", "gyro_scale.z"),
    "gyro_axes_sigma_rad": ("gyro_axes.xy", "gyro_axes.xz", "gyro_axes.yz"),
}
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


def run(data: Path, *, fetch: bool, out: Path | None, as_json: bool) -> int:
    """Judge every set; return 0, 1 if the owners' tool is better, or 2 without the data."""
    progress = Console(stderr=True)
    with ExitStack() as stack:
        if out is None:
            out = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hil-throws-")))
        out.mkdir(parents=True, exist_ok=True)
        (out / "body.urdf").write_text(URDF, encoding="utf-8")
        (out / "mapping.yaml").write_text(yaml.safe_dump(MAPPING), encoding="utf-8")
        recordings: dict[str, list[Path]] = {}
        try:
            if fetch:
                THROWS.fetch(data, progress.print)
            for path in THROWS.files:
                name = path.split("/")[2]
                progress.print(f"{name}: {Path(path).stem}")
                recordings.setdefault(name, []).append(_imported(data, out, path, name))
            overlay = _calibrated(out, recordings, progress.print)
        except DataError as error:
            sys.stderr.write(f"{error}\n")
            return WRONG_EXIT
        sets = {
            name: [_found(out, recording, name, overlay) for recording in own]
            for name, own in recordings.items()
        }
    results = judged(sets)
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


def _imported(data: Path, out: Path, path: str, name: str) -> Path:
    """Import one throw; return the recording."""
    stem = Path(path).stem
    throws.write_csv(THROWS.read(data, path), out / f"{stem}.csv")
    config, recording = _config(out, name), out / f"{stem}.mcap"
    recording.unlink(missing_ok=True)
    mapped = ("import", str(out / f"{stem}.csv"), "--map", str(out / "mapping.yaml"))
    _fsw(*mapped, "--config", str(config), "--out", str(recording))
    return recording


def _config(out: Path, name: str, torque_nm: float | None = None) -> Path:
    """Write and return the configuration of a set; `torque_nm` replaces the air torque's sigma."""
    document = yaml.safe_load(Path(__file__).with_name("throws.yaml").read_text(encoding="utf-8"))
    base, first = document["bodies"]["base"], FIRST_KG_M2[name]
    base["mass_kg"] = _mass_kg(name)
    base["inertia_kg_m2"] = [first, 0.0, 0.0, first, 0.0, first]
    base["sigma"]["inertia_kg_m2"] = [5.0 * first] * 6
    if torque_nm is not None:
        document["estimator"]["wrench_torque_sigma_nm"] = torque_nm
    path = out / f"{name}.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


def _calibrated(out: Path, recordings: dict[str, list[Path]], tell: Callable[[str], None]) -> Path:
    """Return an overlay with the gyro matrix, the unit's attitude and the sigmas of both.

    The throws of the device alone come first; their result is the prior for the proof body.

    Raises
    ------
    DataError if `fsw calibrate` gives no figures.
    """
    path, imu = out / "calibrated.yaml", dict[str, Any]()
    path.write_text("{}\n", encoding="utf-8")
    for name in CALIBRATION:
        own = map(str, recordings[name])
        chosen = ("--config", str(_config(out, name)), "--overlay", str(path), "--json")
        said = _fsw("calibrate", "motion", *own, *chosen)
        if not said.startswith("{"):
            raise DataError(f"{name}: {said}")
        values: dict[str, Any] = json.loads(said)
        for figure in values["figures"]:
            tell(f"{name}: {figure['name']} {figure['value']:+.2g} +- {figure['sigma']:.1g}")
        imu |= {key: own for key, own in values["overlay"].get("imu", {}).items() if key in TAKEN}
        sigmas = {figure["name"]: figure["sigma"] for figure in values["figures"]}
        for key, names in SIGMAS.items():
            imu[key] = max(sigmas[own] for own in names)
        path.write_text(yaml.safe_dump({"imu": imu}), encoding="utf-8")
    return path


def _found(out: Path, recording: Path, name: str, overlay: Path) -> Found:
    """Return the identification of one throw; `mean` is empty if `fsw identify` failed."""
    config = _config(out, name, CALIBRATION_TORQUE_NM if name in CALIBRATION else None)
    chosen = ("--config", str(config), "--overlay", str(overlay))
    said = _fsw("identify", str(recording), *chosen, "--method", "mrnea", "--json")
    if not said.startswith("{"):
        return Found(recording.stem, said or "no result", np.empty(0), np.empty((0, 0)))
    values: dict[str, Any] = json.loads(said)
    P = np.array(values["covariance"])[:10, :10]
    return Found(recording.stem, values["status"], np.array(values["mean"][:10]), P)


def _fsw(*arguments: str) -> str:
    """Return the output of a command, or the last line of its errors."""
    said, wrong = StringIO(), StringIO()
    with redirect_stdout(said), redirect_stderr(wrong):
        code = fsw(list(arguments))
    last = wrong.getvalue().strip().splitlines()[-1:] if code and not said.getvalue() else []
    return said.getvalue() or "".join(last)


def _print(results: list[Result]) -> None:
    print_table(
        "thrown bodies: error of the principal moments, %",
        ("set", "throws", "found", "valid", "mean", "worst", "the owners' tool", "NEES"),
        [
            [
                *(r.name, str(r.throws), str(r.found), str(r.valid)),
                *(f"{r.mean_percent:.2f}", f"{r.worst_percent:.2f}"),
                "{:.2f} / {:.2f}".format(*throws.PUBLISHED[r.name]),
                f"{r.nees:.1f}, median {r.nees_median:.1f}",
            ]
            for r in results
        ],
        120,
        "NEES of the three moments of a throw, 3 where sigma is right, that of the calibration "
        "included.",
        f"{THROWS.what}; github.com/{THROWS.repository} at {THROWS.commit[:7]}, {THROWS.licence}",
    )
