import math
import struct

import numpy as np
import pytest

from hil.devices import sagitta
from hil.devices.plant import Plant
from tests.support.plant_cases import ACC_SLOPE, RATE_SLOPE, AnalyticHistory, sensor_config

MS = 1_000_000
NODES = [{"node_id": 0x11 + i} for i in range(7)]
NOISY = {
    "joints": {"torque_noise_nm": 0.03, "torque_offset_sigma_nm": 0.1},
    "imu": {
        "angle_random_walk_rad_sqrt_s": 4.4e-5,
        "velocity_random_walk_m_s_sqrt_s": 4e-4,
        "gyro_bias_sigma_rad_s": 1e-5,
        "acc_bias_sigma_m_s2": 5e-3,
    },
}


def run_bus(plant: Plant, ticks: int, period_ns: int = 2 * MS) -> list[list]:
    answers = []
    for k in range(ticks):
        plant.frames_until(k * period_ns)
        answers.append(plant.on_frame(k * period_ns, 0x080, bytes([k % 240 + 1])))
    return answers


def pdo1(frames: list) -> list:
    return [f for f in frames if 0x180 < f[1] < 0x200]


def test_nodes_announce_themselves_then_send_heartbeats_of_their_state():
    plant = Plant(AnalyticHistory(), sensor_config(), 1)
    boot = plant.frames_until(0)
    assert [(f[1], f[2]) for f in boot] == [(0x711 + i, b"\0") for i in range(7)]
    before = plant.frames_until(1999 * MS)
    assert {f[2] for f in before} == {b"\x7f"}
    assert len(before) == 7
    plant.on_frame(1999 * MS, 0x000, bytes([1, 0]))
    assert {f[2] for f in plant.frames_until(2999 * MS)} == {b"\x05"}


def test_sync_latches_every_joint_at_its_stamp_and_echoes_its_counter():
    plant = Plant(AnalyticHistory(), sensor_config(), 1, start_delay_s=0.0)
    for k, frames in enumerate(run_bus(plant, 600)):
        state = AnalyticHistory().at(k * 0.002)
        for i, (_, can_id, data, is_fd) in enumerate(pdo1(frames)):
            position, torque, status, counter = struct.unpack("<ihBB", data)
            assert (can_id, status, counter, is_fd) == (0x191 + i, 0x09, k % 240 + 1, False)
            assert abs(position / 2**24 * 2 * math.pi - state.q[i]) < 1.01 * math.pi / 2**24
            assert abs(torque / 100.0 - state.tau[i]) < 0.00501


def test_frames_end_on_the_bus_in_order_and_no_faster_than_it_carries_them():
    plant = Plant(AnalyticHistory(), sensor_config(), 1)
    for k, frames in enumerate(run_bus(plant, 500)):
        ends = [f[0] - 2 * MS * k for f in frames]
        assert [f[1] for f in frames] == sorted(f[1] for f in frames)
        assert ends[0] >= 55_000 + 111_000  # the SYNC itself, then one 8-byte frame, unstuffed
        assert min(np.diff(ends)) >= 111_000
        assert ends[-1] < 2 * MS


def test_fd_nodes_answer_in_twenty_bytes():
    nodes = [n | {"format": "fd"} for n in NODES]
    plant = Plant(AnalyticHistory(), sensor_config({"nodes": nodes}), 1, start_delay_s=0.0)
    frames = run_bus(plant, 200, MS)[199]
    state = AnalyticHistory().at(0.199)
    assert [len(f[2]) for f in frames] == [20] * 7
    assert all(f[3] for f in frames)
    _, velocity, torque = struct.unpack_from("<iii", frames[6][2])
    assert abs(velocity / 2**24 * 2 * math.pi - state.qd[6]) < 2e-7
    assert abs(torque * 1e-4 - state.tau[6]) < 0.51e-4
    assert frames[-1][0] < 200 * MS


def test_node_sign_and_zero_are_those_of_the_raw_value():
    nodes = [n | {"sign": -1, "zero_offset_rad": 0.5} for n in NODES]
    plant = Plant(AnalyticHistory(), sensor_config({"nodes": nodes}), 1, start_delay_s=0.0)
    frame = pdo1(run_bus(plant, 100)[99])[2]
    position, torque = struct.unpack_from("<ih", frame[2])
    state = AnalyticHistory().at(0.198)
    assert abs(-position / 2**24 * 2 * math.pi + 0.5 - state.q[2]) < 4e-7
    assert abs(-torque / 100 - state.tau[2]) < 0.00501


def test_a_prismatic_joint_counts_metres_and_its_encoder_steps_in_them():
    config = sensor_config({"nodes": NODES, "encoder_bits": 10})
    sliding = [k == 2 for k in range(7)]
    plant = Plant(AnalyticHistory(), config, 1, start_delay_s=0.0, sliding=sliding)
    (position,) = struct.unpack_from("<i", pdo1(run_bus(plant, 100)[99])[2][2])
    assert position % 2**14 == 0
    assert abs(position / 2**24 - AnalyticHistory().at(0.198).q[2]) <= 0.5 / 2**10


@pytest.mark.parametrize("form", ["classic", "fd"])
def test_a_node_without_position_sends_its_speed(form):
    """Where position stands in a classic frame; beside a position of zero in one of CAN FD."""
    nodes = [n | {"sign": -1, "encoder": "speed", "format": form} for n in NODES]
    plant = Plant(AnalyticHistory(), sensor_config({"nodes": nodes}), 1, start_delay_s=0.0)
    frame = pdo1(run_bus(plant, 100)[99])[2]
    state = AnalyticHistory().at(0.198)
    first, second = struct.unpack_from("<ii", frame[2])
    speed = first if form == "classic" else second
    assert abs(-speed / 2**24 * 2 * math.pi - state.qd[2]) < 4e-7
    assert form == "classic" or first == 0


def test_noise_of_speeds_is_white_and_leaves_the_other_noise_as_it_was():
    one, other = (n | {"encoder": "speed"} for n in NODES[:2])
    seen = []
    for nodes in (NODES, [one, other, *NODES[2:]]):
        joints = {"nodes": nodes, "torque_noise_nm": 0.03, "speed_noise_rad_s": 0.01}
        plant = Plant(AnalyticHistory(), sensor_config(joints), 1, start_delay_s=0.0)
        frames = [pdo1(answer) for answer in run_bus(plant, 700)]
        seen.append([[struct.unpack_from("<ih", f[2]) for f in answer] for answer in frames])
    plain, turning = np.array(seen, float)
    np.testing.assert_array_equal(plain[:, 2:], turning[:, 2:])
    np.testing.assert_array_equal(plain[:, :, 1], turning[:, :, 1])
    speeds = turning[:, :2, 0] / 2**24 * 2 * math.pi
    noise = speeds - np.array([AnalyticHistory().at(k * 0.002).qd[:2] for k in range(700)])
    assert np.all(np.abs(noise.std(axis=0) / 0.01 - 1) < 5 / math.sqrt(2 * 700))
    lag1 = np.mean(noise[1:] * noise[:-1], axis=0) / 0.01**2
    assert np.all(np.abs(lag1) < 4 / math.sqrt(700))
    assert abs(np.corrcoef(noise.T)[0, 1]) < 4 / math.sqrt(700)


def test_latches_measured_ahead_are_those_of_one_at_a_time(monkeypatch):
    """SYNC at equal steps, late, early and at other steps: each latch has its own instant's truth,
    and the noise that comes next whatever was measured ahead before.
    """

    def positions(ahead: int) -> list[bytes]:
        monkeypatch.setattr("hil.devices.plant.AHEAD", ahead)
        noisy = sensor_config({"torque_noise_nm": 0.05, "encoder_noise_rad": 1e-6})
        plant = Plant(AnalyticHistory(), noisy, 3, start_delay_s=0.1)
        steps = [2 * MS] * 300 + [2 * MS + 7, 2 * MS - 7] * 5 + [2 * MS] * 40 + [20 * MS] * 40
        times = np.cumsum(steps).tolist()
        return [f[2] for t in times for f in pdo1(plant.on_frame(t, 0x080, b"\x01"))]

    assert positions(64) == positions(1)


def test_two_buses_share_one_latch():
    nodes = [n | {"bus": "a" if i < 4 else "b"} for i, n in enumerate(NODES)]
    plant = Plant(AnalyticHistory(), sensor_config({"nodes": nodes, "torque_noise_nm": 0.1}), 1)
    one = Plant(AnalyticHistory(), sensor_config({"torque_noise_nm": 0.1}), 1)
    for k in range(10):
        both = [f for bus in "ab" for f in plant.on_frame(k, 0x080, bytes([k + 1]), bus)]
        single = one.on_frame(k, 0x080, bytes([k + 1]))
        assert sorted(f[2] for f in pdo1(both)) == sorted(f[2] for f in pdo1(single))


@pytest.mark.parametrize("chunking", ["datagram", "ms1", "random"])
@pytest.mark.parametrize(
    ("datagram_id", "crlf", "rate_hz"), [(0xA5, False, 500), (0x91, True, 250)]
)
def test_imu_reading_is_the_truth_at_the_time_the_icd_gives(chunking, datagram_id, crlf, rate_hz):
    imu = {"datagram_id": datagram_id, "crlf": crlf, "rate_hz": rate_hz, "chunking": chunking}
    plant = Plant(AnalyticHistory(), sensor_config(imu=imu), 7, start_delay_s=0.3)
    plant.on_frame(10 * MS, 0x080, b"\x01")
    length = {0xA5: 42, 0x91: 28}[datagram_id] + 2 * crlf
    byte_ns = 10e9 / 921_600
    chunks = [c for k in range(3000) for c in plant.serial_until(k * MS)["imu"]]
    stream = b"".join(data for _, data in chunks)
    handed_over = np.repeat([t for t, _ in chunks], [len(data) for _, data in chunks])
    count = len(stream) // length
    gyro_true, acc_true = plant.imu.truth_ns(np.arange(count))
    sample = plant.imu.sample_ns(np.arange(count))
    tail = 6 + 2 * crlf
    for n in range(count):
        data = stream[n * length : (n + 1) * length]
        latency_ns = 1000 * int.from_bytes(data[-tail:][:2], "big")
        first_bit = sample[n] + latency_ns
        ends = first_bit + np.arange(1, length + 1) * byte_ns
        assert (handed_over[n * length : (n + 1) * length] >= ends - 1.0).all()
        if chunking == "datagram":
            # t_valid = t(last byte) - 10 N / baud - latency - group delay, exact to rounding
            last = handed_over[n * length + length - 1]
            t_gyro = last - length * byte_ns - latency_ns - 2.2e6
            assert abs(t_gyro - gyro_true[n]) <= 2.0
            assert abs(t_gyro - 4.1e6 - acc_true[n]) <= 2.0
        t_s = (np.array([gyro_true[n], acc_true[n]]) - 310 * MS) * 1e-9
        gyro = int.from_bytes(data[1:4], "big", signed=True) * math.radians(2.0**-14)
        acc = int.from_bytes(data[11:14], "big", signed=True) * 2.0**-19 * 9.80665
        assert abs(gyro - RATE_SLOPE * max(t_s[0], 0.0)) < 0.55 * math.radians(2.0**-14)
        assert abs(acc - ACC_SLOPE * max(t_s[1], 0.0)) < 0.55 * 2.0**-19 * 9.80665


def test_imu_clock_errors_fill_their_bound_over_seeds():
    config = sensor_config()
    errors = [Plant(AnalyticHistory(), config, s).imu.clock_error_ppm for s in range(60)]
    assert max(errors) > 35.0
    assert min(errors) < -35.0
    assert max(map(abs, errors)) <= 50.0


def test_imu_counter_counts_internal_samples():
    plant = Plant(AnalyticHistory(), sensor_config(), 7)
    counters = [data[-7] for _, data in plant.serial_until(1000 * MS)["imu"]]
    assert len(counters) in (499, 500)
    assert set(np.diff(counters) % 256) == {4}


def test_startup_flag_is_set_as_long_as_configured():
    plant = Plant(AnalyticHistory(), sensor_config(imu={"startup_s": 0.1}), 7)
    flags = [data[10] for _, data in plant.serial_until(1000 * MS)["imu"]]
    assert flags[:50] == [0x40] * 50
    assert set(flags[50:]) == {0}


def test_a_line_too_slow_for_its_datagrams_is_refused():
    with pytest.raises(ValueError, match="exceed"):
        Plant(AnalyticHistory(), sensor_config(imu={"rate_hz": 2000, "baud_rate": 460_800}), 1)


def test_star_tracker_speaks_when_subscribed_and_its_last_byte_comes_after_the_latency():
    config = sensor_config(star_tracker={"subscribed": False})
    plant = Plant(AnalyticHistory(), config, 7)
    plant.on_frame(0, 0x080, b"\x01")
    assert plant.serial_until(1000 * MS)["star_tracker"] == []
    subscribe = sagitta.frame(bytes([0x21, 0, 18, 24]) + bytes(15))
    plant.write_serial(1000 * MS, "star_tracker", subscribe)
    (_, reply), *chunks = plant.serial_until(20_000 * MS)["star_tracker"]
    assert sagitta.unframe(reply[1:-1]) == bytes([0x21, 0x80, 18, 0])
    assert len(chunks) in (94, 95, 96)
    exposures = plant.star_tracker.truth_ns(np.arange(101)).tolist()
    for arrival, data in chunks:
        payload = sagitta.unframe(data[1:-1])
        escapes = len(data) - sagitta.SOLUTION_BYTES
        exposure = arrival - 100 * MS - escapes * 10e9 / 115_200
        nearest = min(exposures, key=lambda t, at=exposure: abs(t - at))
        assert abs(nearest - exposure) <= 2.0
        (unix_us,) = struct.unpack_from("<Q", payload, 8)
        assert abs(unix_us - 1.8e15 - nearest / 1e3) <= 1.0
        q = np.array(struct.unpack_from("<4f", payload, 16))
        assert abs(np.linalg.norm(q) - 1.0) < 1e-6


def test_a_seed_fixes_every_bit_and_seeds_differ():
    def record(seed: int, step_ms: int) -> tuple:
        plant = Plant(AnalyticHistory(), sensor_config(**NOISY), seed)
        answers, serial = [], {"imu": b"", "star_tracker": b""}
        for k in range(500):
            answers += plant.on_frame(2 * MS * k, 0x080, bytes([k % 240 + 1]))
            if k % step_ms == 0:
                for name, chunks in plant.serial_until(2 * MS * k).items():
                    serial[name] += b"".join(data for _, data in chunks)
        for name, chunks in plant.serial_until(1000 * MS).items():
            serial[name] += b"".join(data for _, data in chunks)
        return answers, serial

    assert record(3, 1) == record(3, 50)
    assert record(3, 1) != record(4, 1)


def test_a_fault_on_one_device_leaves_the_noise_of_the_others():
    plain = Plant(AnalyticHistory(), sensor_config(**NOISY), 3)
    faulty = Plant(AnalyticHistory(), sensor_config(**NOISY), 3)
    faulty.segments["arm"].nodes[2].silent = True
    a = [f for frames in run_bus(plain, 300) for f in pdo1(frames) if f[1] != 0x193]
    b = [f for frames in run_bus(faulty, 300) for f in pdo1(frames)]
    assert [f[1:] for f in a] == [f[1:] for f in b]
    assert plain.serial_until(600 * MS) == faulty.serial_until(600 * MS)


def test_node_count_must_fit_the_robot():
    with pytest.raises(ValueError, match="2 nodes for a robot of 7 joints"):
        Plant(AnalyticHistory(), sensor_config({"nodes": NODES[:2]}), 1)
