import numpy as np
import pytest

from fsw.messages import ImuSamples, JointSamples
from fsw.scheduler.align import MOST_EMPTY, Aligner
from tests.conftest import ArmProject
from tests.support.loop_cases import MS, arm_config
from tests.support.samples import attitude_samples, imu_samples, joint_samples

T0 = 1_000 * MS
WINDOW, LAG = 400 * MS, 150 * MS


@pytest.fixture
def aligner(arm: ArmProject) -> Aligner:
    aligner = Aligner(arm_config(arm), 3)
    aligner.start(T0)
    return aligner


def joint(t_ns: int, received_ns: int | None = None, index: int = 0) -> JointSamples:
    received_ns = t_ns if received_ns is None else received_ns
    return joint_samples((t_ns, received_ns, index, t_ns * 1e-9, 5.0))


def imu(t_gyro_ns: int, t_acc_ns: int, received_ns: int) -> ImuSamples:
    return imu_samples((t_gyro_ns, t_acc_ns, received_ns, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)))


def test_a_window_closes_at_its_end_plus_lag_and_not_before(aligner: Aligner):
    assert aligner.deadline_ns == T0 + WINDOW + LAG
    assert aligner.close(T0 + WINDOW + LAG - 1) == []
    (window,) = aligner.close(T0 + WINDOW + LAG)
    assert (window.index, window.start_ns, window.stop_ns) == (0, T0, T0 + WINDOW)


def test_a_window_where_nothing_came_is_given_out_missing_and_stale(aligner: Aligner):
    windows = aligner.close(T0 + 3 * WINDOW + LAG)
    assert [w.index for w in windows] == [0, 1, 2]
    channel = windows[1].joints[2]
    assert channel.missing
    assert channel.stale
    assert channel.values.shape == (0, 2)
    assert windows[1].attitude.values.shape == (0, 4)


def test_samples_go_by_validity_and_stand_in_time_order(aligner: Aligner):
    for k in (3, 1, 2, 401):
        aligner.push(joint(T0 + k * MS))
    first, second = aligner.close(T0 + 2 * WINDOW + LAG)
    assert first.joints[0].t_ns.tolist() == [T0 + k * MS for k in (1, 2, 3)]
    assert np.allclose(first.joints[0].values[:, 0], first.joints[0].t_ns * 1e-9)
    assert second.joints[0].t_ns.tolist() == [T0 + 401 * MS]


def test_both_ends_of_a_window_belong_to_the_right_one(aligner: Aligner):
    for t in (T0 - 1, T0, T0 + WINDOW - 1, T0 + WINDOW):
        aligner.push(joint(t))
    first, second = aligner.close(T0 + 2 * WINDOW + LAG)
    assert first.joints[0].t_ns.tolist() == [T0, T0 + WINDOW - 1]
    assert second.joints[0].t_ns.tolist() == [T0 + WINDOW]
    assert aligner.counters().early == 1


def test_a_sample_received_after_the_deadline_is_late_however_the_loop_looked(aligner: Aligner):
    deadline = T0 + WINDOW + LAG
    aligner.push(joint(T0 + 1, deadline))
    aligner.push(joint(T0 + 2, deadline + 1))
    (window,) = aligner.close(deadline)
    assert window.joints[0].t_ns.tolist() == [T0 + 1]
    aligner.push(joint(T0 + 3, deadline, index=1))
    assert aligner.counters().late == {
        "axis1": 1,
        "axis2": 1,
        "axis3": 0,
        "imu": 0,
        "star_tracker": 0,
    }


def test_the_clusters_of_a_datagram_go_by_their_own_times(aligner: Aligner):
    aligner.push(imu(T0 + WINDOW + 1, T0 + WINDOW - 1, T0 + WINDOW + 8 * MS))
    first, second = aligner.close(T0 + 2 * WINDOW + LAG)
    assert (len(first.gyro.t_ns), len(first.accelerometer.t_ns)) == (0, 1)
    assert (len(second.gyro.t_ns), len(second.accelerometer.t_ns)) == (1, 0)
    assert second.gyro.values.tolist() == [[1.0, 2.0, 3.0]]


def test_a_flagged_cluster_is_left_out_alone(aligner: Aligner):
    aligner.push(imu_samples((T0, T0, T0, None, (4.0, 5.0, 6.0))))
    (window,) = aligner.close(T0 + WINDOW + LAG)
    assert (len(window.gyro.t_ns), len(window.accelerometer.t_ns)) == (0, 1)


def test_missing_is_below_the_configured_fill_and_stale_is_silence(aligner: Aligner):
    for k in range(60):  # 60 % of the 100 expected at 250 Hz
        aligner.push(joint(T0 + 4 * MS * k))
    for k in range(59):
        aligner.push(joint(T0 + 4 * MS * k, index=1))
    aligner.push(joint(T0 + 4 * MS * 99, index=2))
    (window,) = aligner.close(T0 + WINDOW + LAG)
    assert [j.missing for j in window.joints] == [False, True, True]
    assert [j.stale for j in window.joints] == [True, True, False]


def test_attitude_keeps_its_quaternion(aligner: Aligner):
    aligner.push(attitude_samples((T0 + 1, T0 + 100 * MS, (0.0, 0.6, 0.0, 0.8))))
    (window,) = aligner.close(T0 + WINDOW + LAG)
    assert window.attitude.values.tolist() == [[0.0, 0.6, 0.0, 0.8]]
    assert not window.attitude.missing


def test_samples_before_the_start_are_sorted_in_at_it(arm: ArmProject):
    aligner = Aligner(arm_config(arm), 3)
    assert aligner.deadline_ns is None
    aligner.push(joint(T0 - 1))
    aligner.push(joint(T0 + 1))
    assert aligner.close(T0 + 10 * WINDOW) == []
    aligner.start(T0)
    (window,) = aligner.close(T0 + WINDOW + LAG)
    assert window.joints[0].t_ns.tolist() == [T0 + 1]
    assert aligner.counters().early == 1


def test_absurd_validity_and_floods_cannot_grow_the_buffers(aligner: Aligner):
    aligner.push(joint(T0 + 10**15, T0))
    for k in range(10_000):
        aligner.push(joint(T0 + k))
    assert aligner.counters().future == 1
    (window,) = aligner.close(T0 + WINDOW + LAG)
    assert len(window.joints[0].t_ns) + aligner.counters().overflow == 10_000
    assert len(window.joints[0].t_ns) <= 4 * 100 + 16


def test_given_out_arrays_cannot_be_changed(aligner: Aligner):
    aligner.push(joint(T0))
    (window,) = aligner.close(T0 + WINDOW + LAG)
    with pytest.raises(ValueError, match="read-only"):
        window.joints[0].values[0, 0] = 1.0


def test_the_first_window_that_begins_from_a_time_on(aligner: Aligner):
    aligner.push(joint(T0))
    first = [aligner.first_after(T0 + k) for k in (-1, 0, 1, WINDOW, WINDOW + 1)]
    assert first == [0, 0, 1, 1, 2]
    aligner.close(T0 + 3 * WINDOW + LAG)
    assert aligner.first_after(T0) == aligner.next_index == 3


def test_a_jump_of_the_clock_leaves_a_bounded_number_of_windows(aligner: Aligner):
    years = 1_700_000_000 * 1000 * MS
    aligner.push(joint(T0 + 1 * MS))
    aligner.push(joint(T0 + years))
    windows = aligner.close(T0 + years + WINDOW + LAG)
    index = years // WINDOW
    assert [windows[0].index, windows[-1].index] == [0, index]
    assert len(windows) == 1 + MOST_EMPTY + 1
    assert windows[-1].start_ns <= T0 + years < windows[-1].stop_ns
    assert windows[-1].joints[0].t_ns.tolist() == [T0 + years]
    assert aligner.skipped == index - 1 - MOST_EMPTY
    assert aligner.next_index == index + 1


def test_no_window_of_a_shorter_gap_is_skipped(aligner: Aligner):
    end = T0 + (MOST_EMPTY + 1) * WINDOW
    aligner.push(joint(T0 + 1 * MS))
    aligner.push(joint(end))
    windows = aligner.close(end + WINDOW + LAG)
    assert [window.index for window in windows] == list(range(MOST_EMPTY + 2))
    assert aligner.skipped == 0
