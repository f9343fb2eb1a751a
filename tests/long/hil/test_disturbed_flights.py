"""Flights with flipped, lost and silent devices: consistent, and a replay agrees."""

from pathlib import Path

import numpy as np
import pytest

from fsw.config import load
from hil.faults import taps as faults
from hil.faults.taps import (
    Struck,
    chain,
    change_frame,
    is_tpdo1,
)
from hil.links.virtual import VirtualBench
from tests.support import malformed_cases as cases
from tests.support.malformed_cases import CHI2_10_999, SAME, conserved
from tests.support.taps import flip_payload


def flip_payloads(world: VirtualBench) -> None:
    world.can.tap = Struck(flip_payload, 1e-3, 7, only=is_tpdo1)


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_flipped_bits_of_can_payloads_leave_the_estimate_consistent(
    tmp_path: Path, seed: int
) -> None:
    setup = cases.short(tmp_path, seed)
    recorded = cases.fly(setup, flip_payloads)
    final, status = recorded.final, recorded.status
    assert final.valid, final.reason
    assert cases.normalised_error(setup, final.x, final.covariance) < CHI2_10_999
    arm = status["samples"]["arm"]
    assert arm["rejected"] > 5  # status, counter and high position bits
    assert status["windows"]["outliers"] > 5  # what moves a value less
    assert status["windows"]["unusable"] == 0
    replayed = cases.run(setup.folder / "recording.mcap", load(setup.config_path))
    scale = np.sqrt(np.diag(final.covariance))
    assert np.max(np.abs(replayed.estimate.mean[:10] - final.x) / scale) <= SAME


def test_devices_silent_for_two_seconds_come_back_and_nothing_stops(tmp_path: Path) -> None:
    """Inertial unit, then joint 3, then the star tracker."""
    setup = cases.short(tmp_path, seed=5, total_s=14.0)

    def disturb(world: VirtualBench) -> None:
        assert world.imu is not None
        assert world.star_tracker is not None
        start_ns = world.clock.now_ns()

        def window(first_s: float) -> tuple[int, int]:
            return start_ns + round(first_s * 1e9), start_ns + round((first_s + 2.0) * 1e9)

        world.imu.tap = Struck(faults.drop, 1.0, 1, window_ns=window(3.0))
        world.can.tap = Struck(
            faults.drop, 1.0, 1, only=faults.is_node(0x13), window_ns=window(5.5)
        )
        world.star_tracker.tap = Struck(faults.drop, 1.0, 1, window_ns=window(8.0))

    recorded = cases.fly(setup, disturb)
    samples, windows = recorded.status["samples"], recorded.status["windows"]
    # 2 s at 500, 500 and 5 Hz; one more or less by phase
    for source, lost in (("imu", 1000), ("arm", 1000), ("star_tracker", 10)):
        assert abs(samples[source]["lost"] - lost) <= 1, source
        assert samples[source]["rejected"] == samples[source]["late"] == 0, source
        assert samples[source]["received"] > 40
    codes = [event.code for event in recorded.events]
    for code in ("JOINT_SILENT", "IMU_SILENT", "TRACKER_SILENT"):
        assert codes.count(code) == 1
    assert codes.count("RECOVERED") == 3
    assert 4 <= windows["unusable"] <= 6  # those without joint 3
    assert windows["closed"] == 34
    final = recorded.final
    assert final.valid, final.reason
    assert cases.normalised_error(setup, final.x, final.covariance) < CHI2_10_999
    replayed = cases.run(setup.folder / "recording.mcap", setup.config)
    scale = np.sqrt(np.diag(final.covariance))
    assert np.max(np.abs(replayed.estimate.mean[:10] - final.x) / scale) <= SAME
    assert replayed.samples == samples


def test_live_and_replay_agree_with_every_fault_at_once(tmp_path: Path) -> None:
    setup = cases.short(tmp_path, seed=6)

    def disturb(world: VirtualBench) -> None:
        assert world.imu is not None
        assert world.star_tracker is not None
        byte_faults = (faults.noise(30), faults.truncate, faults.duplicate, faults.flip)
        for k, port in enumerate((world.imu, world.star_tracker)):
            port.tap = chain(*(Struck(a, 0.01, 10 * k + i) for i, a in enumerate(byte_faults)))
        world.can.tap = chain(
            Struck(flip_payload, 1e-3, 30, only=is_tpdo1),
            Struck(change_frame(length=6), 1e-3, 31, only=is_tpdo1),
            Struck(faults.duplicate, 1e-3, 32, only=is_tpdo1),
            Struck(faults.drop, 1e-3, 33),
            Struck(faults.delay(7_000_000), 1e-3, 34, only=is_tpdo1),
        )

    recorded = cases.fly(setup, disturb)
    final = recorded.final
    assert final.valid, final.reason
    assert cases.normalised_error(setup, final.x, final.covariance) < CHI2_10_999
    assert recorded.status["slips"] == 0
    replayed = cases.run(setup.folder / "recording.mcap", setup.config)
    scale = np.sqrt(np.diag(final.covariance))
    assert np.max(np.abs(replayed.estimate.mean[:10] - final.x) / scale) <= SAME
    sigma = np.sqrt(np.diag(replayed.estimate.covariance)[:10])
    np.testing.assert_allclose(sigma, scale, rtol=SAME)
    assert replayed.samples == recorded.status["samples"]
    for source in ("imu", "star_tracker", "arm"):
        assert conserved(replayed.samples[source])
        assert replayed.samples[source]["rejected"] > 0
