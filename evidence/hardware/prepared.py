"""The files of an arm, as its owner makes them: URDF, configuration by `fsw init`, recordings."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

from evidence.hardware.arms import Arm, Motion, Read
from evidence.hardware.data_set import DataError

CONFIG, MAPPING, TABLE, RECORDING = "robot.yaml", "mapping.yaml", "arm.csv", "arm.mcap"


def prepare(arm: Arm, read: Read, folder: Path) -> Path:
    """Write URDF, mapping and configuration; return the configuration's path.

    Raises
    ------
    DataError if the data are missing, or if `fsw init` refuses them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    urdf, config = folder / f"{arm.name}.urdf", folder / CONFIG
    urdf.write_bytes(arm.urdf(read))
    mapping = {
        "time": {"column": "t_s", "unit": "s"},
        "joints": {
            "position": {"columns": "q_{}", "unit": "rad"},
            "torque": {"columns": "tau_{}", "unit": "N m", **arm.torque},
        },
    }
    (folder / MAPPING).write_text(yaml.safe_dump(mapping, sort_keys=False), encoding="utf-8")
    if arm.configuration is not None:
        config.write_text(arm.configuration(), encoding="utf-8")
        return config
    # `fsw init` sees the first recording that choices may use
    shown = next(run for run in arm.runs if not run.held_out)
    (folder / "init").mkdir(exist_ok=True)
    shown.motion(read).write(folder / "init" / TABLE, arm.joints)
    _checked(
        *("init", str(urdf), "--out", str(config), "--force", "--tool", arm.tool),
        *("--unknown", "target", "--base", "clamped", "--imu", "none", "--tracker", "none"),
        *("--target-mass-kg", f"{arm.guess_kg:g}", "--rate-hz", f"{arm.rate_hz:g}"),
        *("--torque", arm.sensor, "--recording", str(folder / "init" / TABLE)),
    )
    return config


def import_motion(arm: Arm, motion: Motion, config: Path, folder: Path) -> Path:
    """Write a motion as CSV and import it; return the recording's path.

    Raises
    ------
    DataError if `fsw import` refuses the table.
    """
    folder.mkdir(parents=True, exist_ok=True)
    motion.write(folder / TABLE, arm.joints)
    recording = folder / RECORDING
    recording.unlink(missing_ok=True)
    _checked(
        *("import", str(folder / TABLE), "--map", str(config.with_name(MAPPING))),
        *("--config", str(config), "--out", str(recording)),
    )
    return recording


def fsw(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `fsw` as a user does."""
    command = [sys.executable, "-m", "fsw", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def _checked(*arguments: str) -> None:
    done = fsw(*arguments)
    if done.returncode != 0:
        said: Any = (done.stderr or done.stdout).strip().splitlines() or ["no word"]
        raise DataError(f"fsw {arguments[0]}: {said[-1]}")
