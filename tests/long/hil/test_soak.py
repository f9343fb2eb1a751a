"""Three minutes of the soak, twice: bounded, exact, honest, and the same to the last bit."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from evidence.soak.campaign import plan, slope_mb, soak, summary
from evidence.soak.epoch import SoakSegment
from evidence.soak.ports import Reversed
from evidence.store import JOURNAL, Store
from hil.__main__ import main
from hil.run.bench import prepare
from hil.world.scenario import load

pytestmark = pytest.mark.timeout(1200)  # a loaded machine
HOURS = 0.05
SEED = 11
EPOCHS = {"epoch_000", "epoch_001"}  # the two that fly at a time


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> list[Store]:
    folders = [tmp_path_factory.mktemp("soak") for _ in range(2)]
    stores = []
    for folder in folders:
        flown: list[SoakSegment] = []
        stores.append(soak(HOURS, 50.0, 125, SEED, folder, 1, flown.append))
        assert [segment.number for segment in flown] == [0, 1, 2]
    return stores


@pytest.mark.slow
def test_three_minutes_under_random_faults_break_nothing(flown: list[Store]) -> None:
    result = summary(flown[0])
    assert result["broken"] == []
    assert result["valid"] == result["segments"] == 3
    assert result["slips"] == result["slips_injected"] > 0
    low, high = result["nees_band_99"]
    assert low <= result["mean_nees"] <= high


@pytest.mark.slow
def test_the_seed_fixes_every_bit(flown: list[Store]) -> None:
    assert summary(flown[0])["sha256"] == summary(flown[1])["sha256"]


@pytest.mark.slow
def test_what_was_flown_is_not_flown_again(flown: list[Store]) -> None:
    again: list[SoakSegment] = []
    store = soak(HOURS, 50.0, 125, SEED, flown[0].folder, 1, again.append)
    assert again == []
    assert store.rows == flown[0].rows


@pytest.mark.slow
def test_an_interrupt_ends_it_at_once_and_leaves_what_can_be_resumed(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hil", "soak", "--hours", "24", "--rate", "50"]
    command += ["--imu-rate", "125", "--jobs", "2", "--out", str(tmp_path)]
    process = subprocess.Popen(
        command,
        stderr=subprocess.PIPE,
        start_new_session=True,
        # a shell starts what it puts into the background with the interrupt ignored
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    )
    try:
        while {path.parent.name for path in tmp_path.glob("epoch_*/*.mcap")} != EPOCHS:
            assert process.poll() is None
            time.sleep(0.1)
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=60)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 130
    assert b"; the same command continues from " in said
    assert not (tmp_path / JOURNAL).exists()


@pytest.mark.parametrize("option", [["soak", "--jobs"], ["faults", "--jobs"], ["kills", "--count"]])
@pytest.mark.parametrize("value", ["0", "-1", "two"])
def test_a_count_below_one_is_refused(
    option: list[str], value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as refused:
        main([*option, value])
    assert refused.value.code == 2
    assert f"{option[1]}: {value}: must be a whole number of at least 1" in capsys.readouterr().err


def test_the_standard_forms_are_as_long_as_they_say() -> None:
    for hours in (2.0, 24.0):
        epochs, segments = plan(hours, 60.0)
        assert epochs == 4
        assert abs(epochs * segments * 63.5 / 3600 - hours) < 0.1


def test_a_leak_of_two_bytes_a_tick_is_seen() -> None:
    store = Store(None, {})
    segments = [
        {
            "ticks": 32_000 * k,
            "resident_bytes": 150_000_000 + 64_000 * k,
            "nees": 10.0,
            "valid": True,
            "slips": 3,
            "injected": 3,
            "broken": [],
            "digest": "a",
        }
        for k in range(1, 30)
    ]
    assert slope_mb(segments)[0] == pytest.approx(2.0)
    store.add("0", {"segments": segments})
    assert "grows 2.00 MB" in summary(store)["broken"][0]
    for segment in segments:
        segment["nees"] = 30.0
    store.add("0", {"segments": segments})
    assert "mean NEES 30.00" in summary(store)["broken"][1]


def test_a_motion_backwards_is_consistent(tmp_path: Path) -> None:
    """Its velocities are the derivatives of its positions, its accelerations theirs."""
    history = Reversed(prepare(load("target_leo"), 0, tmp_path).history)
    t_s, step_s = np.array([20.0]), 1e-4
    before, now, after = (history.at(t_s + k * step_s) for k in (-1, 0, 1))
    assert np.allclose((after.q - before.q) / (2 * step_s), now.qd, atol=1e-6)
    assert np.allclose((after.qd - before.qd) / (2 * step_s), now.qdd, atol=1e-5)
    assert np.allclose((after.w_NB_B - before.w_NB_B) / (2 * step_s), now.wd_NB_B, atol=1e-5)
    turned = before.R_NB[0].T @ after.R_NB[0] / (2 * step_s)
    w = np.array([turned[2, 1], turned[0, 2], turned[1, 0]])
    assert np.allclose(w, now.w_NB_B[0], atol=1e-5)
    assert asdict(now)["tau"].shape == now.q.shape
