"""Torques of which peaks are missing: sines that a range cuts, and what only looks like it."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.health.censored import CensoredTorques
from fsw.health.monitor import Health
from fsw.messages import ChannelWindow, Window
from fsw.messages.findings import Fault
from tests.support.estimator_cases import make_config

WINDOW_NS, STEP_NS, LIMIT_NM = 400_000_000, 2_000_000, 200.0


def config():
    made = make_config()
    buses = tuple(bus.model_copy(update={"rate_hz": 500.0}) for bus in made.buses)
    joints = tuple(
        joint.model_copy(update={"torque_limit_nm": LIMIT_NM, "bus": buses[0].name})
        for joint in made.joints
    )
    return made.model_copy(update={"joints": joints, "buses": buses})


def channel(torque_nm, kept) -> ChannelWindow:
    t_ns = np.arange(0, WINDOW_NS, STEP_NS)[kept]
    values = np.stack([0.1 * np.ones(len(t_ns)), torque_nm[kept]], axis=1)
    return ChannelWindow(t_ns=t_ns, values=values, missing=False, stale=False)


def window_of(torque_nm, kept) -> Window:
    empty = channel(np.zeros(200), np.zeros(200, bool))
    quiet = channel(np.ones(200), np.ones(200, bool))
    joints = [quiet] * len(config().joints)
    joints[1] = channel(torque_nm, kept)
    return Window(
        index=0, start_ns=0, stop_ns=WINDOW_NS, joints=tuple(joints),
        gyro=empty, accelerometer=empty, attitude=empty,
    )  # fmt: skip


def judged(torque_nm, kept):
    return CensoredTorques(config()).judge(window_of(torque_nm, kept))


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 20.0])
@pytest.mark.parametrize("phase", [0.0, 0.7, 2.0])
@pytest.mark.parametrize("peak_nm", [204.0, 230.0, 300.0])
def test_a_torque_whose_peaks_are_cut_is_left_out_and_its_angle_stays(rate_hz, phase, peak_nm):
    t_s = np.arange(200) * 0.002
    torque = peak_nm * np.sin(2 * np.pi * rate_hz * t_s + phase)
    kept = np.abs(torque) <= LIMIT_NM
    window, findings = judged(torque, kept)
    if (~kept).sum() < 2:  # this part of the sine stays below the limit
        assert not findings
        return
    assert np.isnan(window.joints[1].values[:, 1]).all()
    assert (window.joints[1].values[:, 0] == 0.1).all()
    assert not np.isnan(window.joints[0].values).any()
    assert [(one.fault, one.subject) for one in findings] == [
        (Fault.TORQUE_RANGE, config().joints[1].name)
    ]


@pytest.mark.parametrize(
    ("size_nm", "lost"),
    [(199.0, 0), (199.0, 1), (150.0, 40), (170.0, 199)],
    ids=["near", "a spike", "frames lost", "nearly all lost"],
)
def test_other_windows_stay_as_they_are(size_nm, lost):
    torque = size_nm * np.sin(2 * np.pi * 5.0 * np.arange(200) * 0.002)
    kept = np.ones(200, bool)
    kept[50 : 50 + lost] = False
    window, findings = judged(torque, kept)
    assert not findings
    np.testing.assert_array_equal(window.joints[1].values[:, 1], torque[kept])


def test_frames_lost_away_from_the_peaks_leave_a_torque_near_its_limit():
    torque = 199.0 * np.sin(2 * np.pi * 5.0 * np.arange(200) * 0.002)
    kept = np.ones(200, bool)
    kept[np.flatnonzero(np.abs(torque) < 0.8 * LIMIT_NM)[::20]] = False
    window, findings = judged(torque, kept)
    assert (~kept).sum() > 2
    assert not findings
    assert not np.isnan(window.joints[1].values).any()


def test_windows_one_after_the_other_are_one_incident():
    tested = config()
    health, told = Health(tested), []
    torque = 300.0 * np.sin(2 * np.pi * 5.0 * np.arange(200) * 0.002)
    cut = window_of(torque, np.abs(torque) <= LIMIT_NM)
    lag_ns, step_ns = round(tested.estimator.lag_s * 1e9), 50_000_000
    for k in range(5):
        stop_ns = (k + 1) * WINDOW_NS
        health.judge(replace(cut, index=k, start_ns=stop_ns - WINDOW_NS, stop_ns=stop_ns))
        for now_ns in range(stop_ns + lag_ns, stop_ns + lag_ns + WINDOW_NS, step_ns):
            health.tick(0, 0, now_ns)
            told += [event.code for event in health.events()]
    assert told == ["TORQUE_RANGE"]
