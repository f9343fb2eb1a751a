import numpy as np

from fsw.clock import Clock
from fsw.drivers.wire import BytePort, CanFrame, FramePort, frame_list
from hil.devices.plant import Plant
from hil.links.virtual import VirtualBench
from tests.support.plant_cases import AnalyticHistory, sensor_config

MS = 1_000_000


def bench(seed: int = 3, **imu: object) -> VirtualBench:
    plant = Plant(AnalyticHistory(), sensor_config(imu=imu), seed, t0_ns=5 * MS)
    return VirtualBench(plant, 5 * MS, seed=seed)


def taken(port: FramePort) -> list[CanFrame]:
    port.drain()
    return frame_list(port.take()())


def run(world: VirtualBench, ticks: int) -> tuple[list, list, list]:
    """The flight loop's pattern: wake early on serial lines only to read them."""
    clock: Clock = world.clock
    can: FramePort = world.can
    lines: list[BytePort] = [world.imu, world.star_tracker]
    fds = tuple(fd for line in lines for fd in line.wake_fds())
    frames, imu, tracker = [], [], []
    t0 = clock.now_ns()
    for k in range(ticks):
        while not clock.sleep_until_ns(t0 + 2 * MS * k, fds):
            imu += lines[0].read()
            tracker += lines[1].read()
        frames.append(can.write(0x080, bytes([k % 240 + 1])))
        frames += taken(can)
        imu += lines[0].read()
        tracker += lines[1].read()
    return frames, imu, tracker


def test_sync_is_stamped_when_sent_and_answered_by_the_next_tick():
    frames, _, _ = run(bench(), 100)
    syncs = [f for f in frames if f.can_id == 0x080]
    assert [f.t_ns for f in syncs] == [5 * MS + 2 * MS * k for k in range(100)]
    answers = [f for f in frames if 0x180 < f.can_id < 0x200]
    assert len(answers) == 7 * 99
    for f in answers:
        sent = next(s for s in syncs if s.data[0] == f.data[7])
        assert f.t_ns == sent.t_ns + 2 * MS


def test_serial_chunks_are_stamped_a_little_after_the_wire_and_never_before():
    world = bench()
    _, imu, tracker = run(world, 2000)
    assert len(tracker) in (19, 20)
    sample = world.plant.imu.sample_ns(np.arange(len(imu)))
    delays = []
    for n, chunk in enumerate(imu):
        latency = 1000 * int.from_bytes(chunk.data[-6:-4], "big")
        delays.append(chunk.t_ns - (sample[n] + latency + 42 * 10e9 / 921_600))
    assert min(delays) >= -1.0
    assert 1e4 < np.median(delays) < 1e5  # 40 us on average, exponential: median 28 us
    assert np.all(np.diff([c.t_ns for c in imu]) > 0)


def test_nothing_is_lost_whatever_the_chunking():
    streams = []
    for chunking in ("datagram", "ms1", "random"):
        _, imu, _ = run(bench(chunking=chunking), 500)
        streams.append(b"".join(c.data for c in imu))
    shortest = min(map(len, streams))
    assert shortest > 42 * 480
    assert len({s[:shortest] for s in streams}) == 1


def test_a_tap_sees_what_the_host_gets_and_may_drop_or_delay_it():
    world = bench()
    world.can.tap = lambda frames: [f for f in frames if f[1] != 0x193]
    world.imu.tap = lambda chunks: [(t + 10 * MS, data) for t, data in chunks]
    frames, imu, _ = run(world, 500)
    assert not [f for f in frames if f.can_id == 0x193]
    plain = bench()
    _, expected, _ = run(plain, 500)
    assert [c.data for c in imu] == [c.data for c in expected[: len(imu)]]
    assert imu[100].t_ns - expected[100].t_ns > 9 * MS


def test_a_tap_that_drops_everything_does_not_stop_time():
    world = bench()
    world.imu.tap = lambda _: []
    _, imu, _ = run(world, 100)
    assert imu == []
    assert world.clock.now_ns() == 5 * MS + 2 * MS * 99


def test_the_bench_is_deterministic_from_its_seed():
    assert run(bench(8), 300) == run(bench(8), 300)
    assert run(bench(8), 300) != run(bench(9), 300)


def test_a_sleep_without_descriptors_ends_at_its_deadline():
    world = bench()
    assert world.clock.sleep_until_ns(50 * MS)
    assert world.clock.now_ns() == 50 * MS
    assert world.clock.sleep_until_ns(40 * MS)
    assert world.clock.now_ns() == 50 * MS


def test_a_plant_that_produces_sync_stamps_it_at_the_latch():
    config = sensor_config({"sync_rate_hz": 400.0})
    plant = Plant(AnalyticHistory(), config, 3, start_delay_s=0.1)
    world = VirtualBench(plant, 0)
    frames = []
    for k in range(1, 401):
        world.clock.sleep_until_ns(k * 2 * MS)
        frames += taken(world.can)
    syncs = [f for f in frames if f.can_id == 0x080]
    assert [f.t_ns for f in syncs] == [2_500_000 * (k + 1) for k in range(320)]
    assert [f.data[0] for f in syncs] == [k % 240 + 1 for k in range(320)]
    assert [f.t_ns for f in frames] == sorted(f.t_ns for f in frames)
    answers = [f for f in frames if f.can_id == 0x191]
    for sync, frame in zip(syncs, answers, strict=False):
        t_s = max(0.0, (sync.t_ns - 102_500_000) * 1e-9)
        position = int.from_bytes(frame.data[:4], "little", signed=True)
        q = AnalyticHistory().at(t_s).q[0]
        assert abs(position / 2**24 * 2 * np.pi - q) < 4e-7
