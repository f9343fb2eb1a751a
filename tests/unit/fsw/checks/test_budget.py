"""Link budgets against independent figures."""

import pytest

from fsw.checks import budget
from fsw.config import load

# bits of the longest base frame of n data bytes: published table of Davis, Burns, Bril, Lukkien,
# "Controller Area Network (CAN) schedulability analysis", Real-Time Systems 35 (2007): 55 + 10 n
DAVIS_BITS = {n: 55 + 10 * n for n in range(9)}


@pytest.mark.parametrize("size", range(9))
def test_a_classic_frame_is_as_long_as_the_published_bound(size):
    assert budget.classic_frame_s(size, 1.0) == DAVIS_BITS[size]


def seven_joints(arm, rate_hz, **bus):
    arm.data["joints"] = [
        {**arm.data["joints"][0], "name": f"a{k}", "node_id": k, "format": "classic"}
        for k in range(1, 8)
    ]
    arm.data["scheduler"]["tick_rate_hz"] = rate_hz
    arm.data["buses"][0].update(rate_hz=rate_hz, **bus)
    if bus.get("fd"):
        for joint in arm.data["joints"]:
            joint["format"] = "fd"
    return load(arm.write())


@pytest.mark.parametrize(("rate_hz", "percent"), [(250.0, 27.6), (500.0, 55.2), (1000.0, 110.4)])
def test_seven_classic_joints_load_the_bus_as_counted_by_hand(arm, rate_hz, percent):
    # per cycle: SYNC 65 bits, 7 TPDO1 of 135, 7 TPDO2 of 135 in every tenth
    config = seven_joints(arm, rate_hz)
    load_ratio = budget.bus_load(config, config.buses[0])
    assert 100 * load_ratio == pytest.approx(percent, abs=0.1)


def test_seven_fd_joints_at_one_kilohertz_fit(arm):
    config = seven_joints(arm, 1000.0, fd=True, bitrate=1_000_000, data_bitrate=5_000_000)
    assert 0.55 < budget.bus_load(config, config.buses[0]) < 0.70


def test_joints_of_another_bus_do_not_count(arm):
    config = load(arm.write())
    other = config.buses[0].model_copy(update={"name": "other"})
    assert budget.bus_load(config, other) == pytest.approx(65e-6 * 250)


def test_delays_add_up(arm):
    config = load(arm.write())
    assert budget.joint_delay_s(config.buses[0], config.scheduler) == pytest.approx(
        0.004 + 0.02 + 0.002
    )
    imu_s = 0.0063 + 0.002 + 65 * 10 / 921600 + 0.002
    assert budget.imu_delay_s(config.imu, config.scheduler) == pytest.approx(imu_s)
    tracker_s = 0.1 + 176 * 10 / 115200 + 0.002
    assert config.star_tracker is not None
    delay_s = budget.star_tracker_delay_s(config.star_tracker, config.scheduler)
    assert delay_s == pytest.approx(tracker_s)


def test_the_line_load_counts_ten_bits_per_byte_and_the_line_end(arm):
    arm.data["imu"].update(crlf=True, rate_hz=1000.0, baud_rate=460800)
    shortest, longest = budget.imu_load(load(arm.write()).imu)
    assert shortest == pytest.approx(30 * 10 * 1000 / 460800)
    assert longest == pytest.approx(65 * 10 * 1000 / 460800)


def test_the_line_load_is_that_of_the_drivers_own_packets(arm):
    arm.data["imu"].update(driver="mip", rate_hz=100.0, baud_rate=115200)
    shortest, longest = budget.imu_load(load(arm.write()).imu)
    assert shortest == pytest.approx((6 + 14 + 14 + 10) * 10 * 100 / 115200)
    assert longest == pytest.approx((6 + 128) * 10 * 100 / 115200)
