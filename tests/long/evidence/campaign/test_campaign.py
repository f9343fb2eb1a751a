"""Campaigns: every run once whatever is killed, the same bits wherever they are run."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evidence import pool
from evidence.campaign.config import Campaign, CampaignRun, read
from evidence.campaign.summary import summary
from evidence.campaign.work import rows_of, rows_of_lost
from evidence.store import JOURNAL
from hil.world.scenario import ScenarioError

ROOT = Path(__file__).parents[4]
FILE = """
level: sample
seeds: {first: 5, count: 6}
scenarios: [target_leo]
duration_s: 12.0
rate_hz: 50.0
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    place = tmp_path / "small.yaml"
    place.write_text(FILE, encoding="utf-8")
    return place


def run_of(seed: int, **changes: Any) -> CampaignRun:
    values = {
        "level": "sample",
        "scenario": "target_leo",
        "noise": "data sheet",
        "trajectory": None,
        "duration_s": 12.0,
        "rate_hz": 50.0,
        "seed": seed,
    }
    return CampaignRun(**(values | changes))


def command(path: Path, out: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "hil", "campaign", str(path), "--out", str(out), *more]


def digests(out: Path) -> dict[str, str]:
    pytest.importorskip("pyarrow", reason="needs the extra campaign")
    from pyarrow import parquet

    rows = parquet.read_table(out / "results.parquet").to_pylist()
    found = {row["key"]: row["digest"] for row in rows}
    assert len(found) == len(rows)
    return found


def environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}


def test_a_file_is_the_product_of_what_it_names(path: Path):
    campaign = read(path)
    assert [run.seed for run in campaign.runs()] == [5, 6, 7, 8, 9, 10]
    more = campaign.model_copy(
        update={"noises": ("data sheet", "poor IMU"), "scenarios": ("base", "target_leo")}
    )
    keys = [run.key for run in more.runs()]
    assert len(set(keys)) == len(keys) == 24


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("noises: [loud]", "loud"),
        ("scenarios: [nowhere]", "nowhere"),
        ("rate_hz: -1.0", r"rate_hz: must be above 0 \(value: -1\.0\)"),
        ("rate_hz: .inf", "rate_hz"),
        ("duration_s: .inf", "duration_s"),
        ("noises: []", "noises"),
        ("trajectories: []", "trajectories"),
        ("trajectories: [nosuch.yaml]", "trajectories.*nosuch"),
        ("scenarios: [nowhere.yaml]", "scenarios.*nowhere"),
        ("speed: 1", "speed"),
    ],
)
def test_what_is_wrong_is_named(path: Path, line: str, named: str):
    key = line.split(":", maxsplit=1)[0]
    kept = [old for old in FILE.splitlines() if not old.startswith(key)]
    path.write_text("\n".join([*kept, line]), encoding="utf-8")
    with pytest.raises(ScenarioError, match=named):
        read(path)


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"- 1\n", b"", b"a: [1\nb: 2\n"])
def test_a_file_that_is_no_mapping_is_told_in_one_line(path: Path, content: bytes):
    path.write_bytes(content)
    with pytest.raises(ScenarioError) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--workers", "0"], "--workers"),
        (["--scheduler", "bogus://x"], "--scheduler bogus://x"),
        (["--out", "{file}"], "--out"),
    ],
)
def test_wrong_options_are_told_in_one_line_with_exit_code_2(path: Path, options, named):
    command = [sys.executable, "-m", "hil", "campaign", str(path)]
    if "--out" not in options:
        command += ["--out", str(path.parent / "out")]
    command += [word.format(file=path) for word in options]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment())
    assert done.returncode == 2
    assert named in done.stderr
    assert "Traceback" not in done.stderr


def test_a_failing_run_is_recorded_with_seed_and_traceback():
    (row,) = rows_of(run_of(3, trajectory="/nowhere.yaml")).values()
    assert (row["seed"], row["status"]) == (3, "FAILED")
    assert "FileNotFoundError" in row["traceback"]
    assert row["key"] == run_of(3, trajectory="/nowhere.yaml").key


def test_the_summary_is_calibrated():
    """Errors drawn from what is claimed: NEES in its band, efficiency 1 within its interval."""
    rng = np.random.default_rng(4)
    sigma = np.array([0.1, 2.0, 30.0])
    rows = []
    for seed in range(400):
        error = sigma * rng.standard_normal(3)
        rows.append(
            {
                "scenario": "s",
                "noise": "n",
                "trajectory": "",
                "seed": seed,
                "status": "OK",
                "error": error.tolist(),
                "bound": sigma.tolist(),
                "nees": float(np.sum((error / sigma) ** 2)),
                **dict.fromkeys(
                    ("mean_position_m", "max_position_m", "mean_angle_rad", "max_angle_rad"),
                    float(abs(error[0])),
                ),
            }
        )
    rows.append({"scenario": "s", "noise": "n", "trajectory": "", "seed": 9, "status": "FAILED"})
    (entry,) = summary(rows)
    assert (entry["runs"], entry["failed"], entry["not_valid"]) == (401, 1, 0)
    assert entry["nees_band"][0] < entry["nees"] < entry["nees_band"][1]
    for low, high in zip(entry["efficiency_low"], entry["efficiency_high"], strict=True):
        assert low < 1.0 < high
    tool = entry["mean_position_m"]
    expected = 0.1 * np.sqrt(2 / np.pi)
    assert abs(tool["mean"] - expected) < 2 * tool["half_interval"]


def test_one_process_two_processes_and_dask_give_the_same_bits(path: Path, tmp_path: Path):
    distributed = pytest.importorskip("distributed", reason="needs the extra campaign")
    campaign: Campaign = read(path)
    runs = campaign.runs()[:4]
    one = rows_by_key(pool.over_processes(rows_of, runs, 1))
    two = rows_by_key(pool.over_processes(rows_of, runs, 2))
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=str(tmp_path)
    ) as cluster:
        keyed = {run.key: run for run in runs}
        address = cluster.scheduler_address
        dask = rows_by_key(pool.over_dask(rows_of, keyed, address, rows_of_lost))
        ((_, words),) = pool.over_dask(int, {"k": "three"}, address, lambda _, words: words)
    assert words.startswith("ValueError: invalid literal")
    assert {row["status"] for row in one.values()} == {"OK"}
    for found in (two, dask):
        assert {k: v["digest"] for k, v in found.items()} == {
            k: v["digest"] for k, v in one.items()
        }


def rows_by_key(ran: Iterable[tuple[CampaignRun, dict[str, Any]]]) -> dict[str, Any]:
    return {key: row for _, rows in ran for key, row in rows.items()}


def children(pid: int) -> list[int]:
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    return [int(word) for word in text.split()]


def is_worker(pid: int) -> bool:
    return b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()


def lines(out: Path) -> int:
    journal = out / JOURNAL
    return len(journal.read_bytes().splitlines()) if journal.exists() else 0


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_killing_a_worker_and_the_driver_loses_and_doubles_nothing(path: Path, tmp_path: Path):
    whole, out = tmp_path / "whole", tmp_path / "killed"
    subprocess.run(command(path, whole), env=environment(), check=True, capture_output=True)
    driver = subprocess.Popen(
        command(path, out), env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    until(lambda: lines(out) >= 1, driver)
    worker = next(pid for pid in children(driver.pid) if is_worker(pid))
    os.kill(worker, signal.SIGKILL)
    until(lambda: lines(out) >= 3, driver)
    driver.kill()
    driver.wait()
    assert lines(out) >= 3
    subprocess.run(command(path, out), env=environment(), check=True, capture_output=True)
    assert digests(out) == digests(whole)
    assert "<h2>Bad runs" in (out / "campaign.html").read_text(encoding="utf-8")
    keys = [json.loads(row)[0] for row in (out / JOURNAL).read_text().splitlines()]
    assert len(keys) == len(set(keys)) == 6


def until(condition: Any, process: subprocess.Popen[bytes]) -> None:
    """Wait for a condition that a running process brings about."""
    while not condition():
        if process.poll() is not None:
            return
        time.sleep(0.02)
