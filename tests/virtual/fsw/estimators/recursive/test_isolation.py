"""Innovations channel by channel: one that does not fit is left out, a change of many is not."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.recursive.online import OnlineEstimator, build_online
from fsw.messages import Block
from tests.support.estimator_cases import N, make_config, noisy_blocks

ARMED = 30  # blocks before the first fault


def estimator() -> OnlineEstimator:
    return build_online(make_config())


@pytest.fixture(scope="module")
def blocks() -> list[Block]:
    return noisy_blocks("target", seed=4, stop_s=20.0)


def faults(tested: OnlineEstimator, blocks: list[Block]) -> list[tuple[str, str]]:
    found = []
    for block in blocks:
        tested.push(block)
        found += [(str(f.fault), f.subject) for f in tested.findings()]
    return found


def torque(block: Block, offset_nm: float) -> Block:
    tau = block.tau_nm.copy()
    tau[:, 2] += offset_nm
    return replace(block, tau_nm=tau)


def test_clean_blocks_raise_nothing(blocks: list[Block]) -> None:
    assert faults(estimator(), blocks) == []


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda b: torque(b, 2.0), ("TORQUE_INCONSISTENT", "joint3")),
        (lambda b: replace(b, f_NS_B_m_s2=b.f_NS_B_m_s2 + 0.1),
         ("ACC_INCONSISTENT", "accelerometer")),
        (lambda b: replace(b, w_NB_B_rad_s=b.w_NB_B_rad_s + 1e-3), ("GYRO_INCONSISTENT", "gyro")),
    ],
)  # fmt: skip
def test_a_wrong_channel_is_left_out_and_comes_back(
    blocks: list[Block], change, expected: tuple[str, str]
) -> None:
    """The estimate is that of the same blocks with the channel missing from the first to the last
    wrong one, and for one more block, which only tells that the sensor fits again."""
    wrong = range(ARMED, ARMED + 4)
    tested = estimator()
    bad = [change(b) if k in wrong else b for k, b in enumerate(blocks)]
    found = faults(tested, bad)
    assert found == [expected] * len(wrong)

    def without(block: Block) -> Block:
        if expected[1] == "gyro":
            return replace(block, has_gyro=False)
        if expected[1] == "accelerometer":
            return replace(block, has_accelerometer=False)
        return replace(block, has_joint=np.arange(N) != 2)

    reference = estimator()
    out = range(ARMED, ARMED + 5)
    faults(reference, [without(b) if k in out else b for k, b in enumerate(blocks)])
    a, b = tested.finish(), reference.finish()
    sigma = np.sqrt(np.diag(b.covariance))
    assert np.max(np.abs(a.mean - b.mean) / sigma) < 1e-6
    np.testing.assert_allclose(np.sqrt(np.diag(a.covariance)), sigma, rtol=1e-6)


def test_two_wrong_channels_at_once_are_no_sensor_s_fault(blocks: list[Block]) -> None:
    def change(block: Block) -> Block:
        return replace(torque(block, 2.0), f_NS_B_m_s2=block.f_NS_B_m_s2 + 0.1)

    bad = [change(b) if k == ARMED else b for k, b in enumerate(blocks)]
    assert faults(estimator(), bad) == []
