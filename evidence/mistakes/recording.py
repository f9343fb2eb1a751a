"""A mistake as a user meets it: readings in a CSV, `fsw import`, `fsw check` and `fsw identify`."""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from evidence.methods.cases import RATE_HZ
from evidence.mistakes.readings import Readings, by_joint, delay_s
from evidence.mistakes.wires import describe, frames, write_candump
from fsw.__main__ import main as fsw
from fsw.config import Config
from hil.world.inertia import FloatArray

START_S = 100.0  # stamps of a log do not begin at zero
DIGITS = 12
ASKED = "is the unit in the mapping right"
FAULTS = ("WRONG", "doubtful", ASKED)
CONFIG, RECORDING, LOG = "sampled.yaml", "recording.mcap", "candump.log"
SEED = 5  # of the bus
HOLDOUT = ("--holdout", "0.2")
MAPPING = {
    "joints": {
        "file": "joints.csv",
        "time": {"column": "t", "unit": "s"},
        "position": {"columns": "q_{}", "unit": "rad"},
        "torque": {"columns": "tau_{}", "unit": "N m"},
    },
    "imu": {
        "file": "imu.csv",
        "time": {"column": "t", "unit": "s"},
        "rate": {"columns": "w{}", "unit": "rad/s"},
        "specific_force": {"columns": "f{}", "unit": "m/s2"},
    },
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """What the commands say of a recording."""

    findings: tuple[str, ...]  # lines of import and check on what does not fit
    status: str  # of `fsw identify`, or its error
    passed: bool  # whether `fsw identify --holdout` says so
    values: Mapping[str, Any]  # of `fsw identify --json`; empty: there is no result


def judged(
    readings: Readings,
    right: Config,
    used: Config,
    folder: Path,
    wired: Callable[[dict[str, Any]], None] | None = None,
) -> Recorded:
    """Return what import, check and identify say of readings with the configuration `used`.

    `wired`: the joints are on a bus, and this changes the configuration that describes them.
    """
    config, recording = _configured(used, right, folder, wired), folder / RECORDING
    names = [joint.name for joint in used.joints]
    positions, torques = by_joint(readings, right, used)
    torques = _at(readings.t_joint_s, readings.t_torque_s, torques)
    titles = ["t", *(f"q_{name}" for name in names), *(f"tau_{name}" for name in names)]
    if wired is None:
        _write(folder / "joints.csv", titles, [readings.t_joint_s, positions, torques])
    else:
        _send(folder / LOG, readings.t_joint_s, positions, torques)
    titles = ["t", *(f"{kind}{axis}" for kind in "wf" for axis in "xyz")]
    _write(folder / "imu.csv", titles, [readings.t_imu_s, readings.rate, readings.force])
    mapping = MAPPING if wired is None else {"imu": MAPPING["imu"]}
    (folder / "map.yaml").write_text(yaml.safe_dump(mapping), encoding="utf-8")
    mapped = ["--map", str(folder / "map.yaml"), "--config", str(config)]
    mapped += [] if wired is None else ["--can", f"arm={folder / LOG}"]
    said = _said("import", *mapped, "--out", str(recording))
    if not recording.exists():
        return Recorded(findings=tuple(said), status="import refused", passed=False, values={})
    lines = said + _said("check", str(config), str(recording))
    found = tuple(line for line in lines if any(word in line for word in FAULTS))
    text = _said("identify", str(recording), "--config", str(config), *HOLDOUT, "--json")
    values: dict[str, Any] = next((json.loads(line) for line in text if line.startswith("{")), {})
    return Recorded(
        findings=found,
        status=values.get("status", text[-1]),
        passed=values.get("holdout", {}).get("passed", False),
        values=values,
    )


def _configured(
    used: Config,
    right: Config,
    folder: Path,
    wired: Callable[[dict[str, Any]], None] | None,
) -> Path:
    """Write the configuration for a log, without a star tracker; return its path."""
    data = used.model_dump(mode="json")
    buses = [bus.name for bus in used.buses]
    data["buses"] = [{"name": k, "interface": "samples", "rate_hz": RATE_HZ} for k in buses]
    wanted = max(0.0, delay_s(right, used))
    data["imu"] |= {
        "driver": "samples",
        "gyro_group_delay_s": wanted,
        "acc_group_delay_s": wanted,
    }
    for key in ("port", "baud_rate"):
        data["imu"].pop(key, None)
    data["star_tracker"] = None
    data["scheduler"]["tick_rate_hz"] = RATE_HZ
    if wired is not None:
        describe(data, RATE_HZ)
        wired(data)
    path = folder / CONFIG
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def _send(path: Path, t_s: FloatArray, positions: FloatArray, torques: FloatArray) -> None:
    """Write the log of the bus."""
    rng = np.random.default_rng(SEED)
    joints = zip(positions.T, torques.T, strict=True)
    sent = [frame for k, own in enumerate(joints) for frame in frames(k, t_s, *own, rng)]
    write_candump(path, sent, START_S)


def _write(path: Path, titles: Sequence[str], columns: Sequence[FloatArray]) -> None:
    table = np.column_stack(columns)
    table[:, 0] += START_S
    rows = [",".join(f"{value:.{DIGITS}g}" for value in row) for row in table.tolist()]
    path.write_text("\n".join([",".join(titles), *rows]) + "\n", encoding="utf-8")


def _said(*arguments: str) -> list[str]:
    """Return the lines that a command prints, those of its errors first."""
    said, wrong = StringIO(), StringIO()
    with redirect_stdout(said), redirect_stderr(wrong):
        fsw(list(arguments))
    lines = [*wrong.getvalue().splitlines(), *said.getvalue().splitlines()]
    return [line for line in lines if line] or [""]


def _at(t_s: FloatArray, own_s: FloatArray, values: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(t_s, own_s, column) for column in values.T])
