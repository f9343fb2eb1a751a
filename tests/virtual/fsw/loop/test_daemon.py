"""The wiring, on fake ports and a fake clock, with the real sources and faked estimation."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsw.drivers.wire import CanFrame
from fsw.errors import EstimatorError, PortError
from fsw.estimation.science import Science
from fsw.estimators.pipeline import Pipeline
from fsw.loop.ports import Ports
from fsw.messages import Block
from fsw.messages.commands import Command, CommandName
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.link.packets import Layout
from hil.run.daemon import Daemon
from tests.conftest import ArmProject
from tests.support.loop_cases import (
    MS,
    FakeCan,
    FakeClock,
    FakeConditioner,
    FakeEstimator,
    FakeSerial,
    KeepSink,
    arm_config,
)
from tests.support.samples import attitude_samples, imu_samples

EVERY_TICK_S = 1e-6


class Bench:
    """Three joints on one bus at 250 Hz, ticks at 500 Hz; inputs are judged at every tick."""

    def __init__(self, arm: ArmProject, batch_s: float = EVERY_TICK_S, **more) -> None:
        self.clock = FakeClock(10**9)
        self.can, self.imu = FakeCan(self.clock), FakeSerial(self.clock, (7,))
        self.tracker = FakeSerial(self.clock)
        self.sink, self.estimator = KeepSink(), FakeEstimator()
        self.conditioner = FakeConditioner()
        self.daemon: Daemon = Daemon(
            arm_config(
                arm,
                estimator={"window_s": 0.1, "lag_s": 0.05},
                scheduler={"batch_s": batch_s},
            ),
            self.clock,
            Ports(can={"arm": self.can}, imu=self.imu, star_tracker=self.tracker, **more),
            self.sink,
            pipeline=Pipeline(conditioner=self.conditioner, estimator=self.estimator),
        )

    def answer(self) -> None:
        """Each node answers the newest SYNC, half a millisecond after it."""
        syncs = [w for w in self.can.written if w[1] == 0x080]
        t_ns, _, data = syncs[-1]
        for node in (0x11, 0x12, 0x13):
            pdo = struct.pack("<ihBB", 1000, 250 + data[0] % 7, 0x09, data[0])
            self.can.queue.append(CanFrame(t_ns + MS // 2, 0x180 + node, pdo))

    def run(self, ticks: int) -> None:
        for k in range(ticks):
            if k % 2:
                self.answer()
            self.daemon.step()


@pytest.fixture
def bench(arm: ArmProject) -> Bench:
    return Bench(arm)


def test_a_long_batch_takes_four_ticks_and_ends_at_the_first_of_them(arm: ArmProject):
    bench = Bench(arm, batch_s=0.04)
    bench.run(20)
    handed = len(bench.sink.frames)
    bench.run(3)
    assert len(bench.sink.frames) == handed  # taken, read, and put in order
    bench.run(1)
    new = bench.sink.frames[handed:]
    assert len(new) == 10 * 4  # SYNCs of ten periods, three answers each
    assert max(frame.t_ns for frame in new) == 10**9 + 20 * 2 * MS  # the SYNC of the first


def test_the_first_tick_starts_the_nodes_subscribes_and_sends_the_first_sync(bench: Bench):
    bench.daemon.step()
    sent = [(can_id, data.hex()) for _, can_id, data in bench.can.written]
    assert sent == [(0, "0111"), (0, "0112"), (0, "0113"), (0x080, "01")]
    assert bench.tracker.written[0][2].hex().startswith("c02100121800")
    assert bench.can.written[-1][0] == 10**9


def test_a_tracker_that_talks_by_itself_is_asked_nothing(arm: ArmProject):
    arm.data["star_tracker"]["subscribe"] = False
    bench = Bench(arm)
    bench.daemon.step()
    assert bench.tracker.written == []


def test_sync_goes_out_at_the_bus_rate_and_every_frame_is_recorded_in_order(bench: Bench):
    bench.run(10)
    syncs = [(t, data[0]) for t, can_id, data in bench.can.written if can_id == 0x080]
    assert syncs == [(10**9 + 4 * MS * k, k + 1) for k in range(5)]
    stamps = [frame.t_ns for frame in bench.sink.frames]
    assert stamps == sorted(stamps)
    assert len(bench.sink.frames) == 3 + 5 + 15


def test_windows_are_closed_by_the_lag_and_pushed_once_in_order(bench: Bench):
    bench.run(175)
    assert len(bench.conditioner.windows) == 2
    bench.run(1)  # at 350 ms: window 2 ends at 300 ms and closes there
    assert bench.estimator.pushed == [0, 1, 2]
    joints = bench.conditioner.windows[1].joints
    assert [len(j.t_ns) for j in joints] == [25, 25, 25]
    assert joints[0].t_ns[0] == 10**9 + 100 * MS
    assert [e.blocks for e in bench.sink.estimates] == [1, 2, 3]
    assert bench.estimator.calls == ["push", "work"] * 3


@pytest.mark.parametrize("batch_s", [0.007, 0.02, 0.04, 0.05])
def test_windows_do_not_depend_on_the_length_of_a_batch(
    arm: ArmProject, tmp_path: Path, batch_s: float
):
    """A batch ends at a window's deadline, too."""
    benches = [Bench(arm), Bench(ArmProject(tmp_path), batch_s)]
    for bench in benches:
        bench.run(175)
        assert len(bench.conditioner.windows) == 2
        bench.run(1)
        assert bench.estimator.pushed == [0, 1, 2]
    fine, coarse = (bench.conditioner.windows for bench in benches)
    assert str(fine) == str(coarse)
    recorded = [bench.sink.frames for bench in benches]
    assert recorded[1] == recorded[0][: len(recorded[1])]
    assert len(recorded[0]) - len(recorded[1]) <= 4 * batch_s * 250.0


def test_samples_are_judged_in_batches_and_read_at_every_tick(arm: ArmProject):
    bench = Bench(arm, 0.04)
    for recorded in (3 + 1, 3 + 1 + 40, 3 + 1 + 80):  # a batch is that of twenty ticks
        bench.run(20)
        assert bench.can.queue == []
        assert len(bench.sink.frames) == recorded


def test_a_window_that_began_before_a_reset_does_not_reach_the_estimator(bench: Bench):
    """Windows of 100 ms from 1 s on; the reset at 1.122 s, in window 1, which closes at 1.25 s."""
    bench.run(61)
    bench.daemon.submit(Command(name=CommandName.RESET))
    bench.run(115)
    assert bench.estimator.pushed == [2]
    assert [block.index for block in bench.sink.blocks] == [0, 1, 2]


def test_jobs_and_checkpoints_get_a_block_as_the_estimator_used_it(bench: Bench):
    def screened(block: Block) -> Block:
        return replace(block, has_joint=np.zeros_like(block.has_joint))

    bench.estimator.screened = screened
    bench.run(90)
    assert [block.index for block in bench.sink.blocks] == bench.estimator.pushed == [0]
    assert not bench.sink.blocks[0].has_joint.any()


def test_a_backlog_of_windows_is_worked_off_in_order_before_the_newest(bench: Bench):
    """A stall of three windows: when it ends, no window waits behind another."""
    bench.run(20)
    bench.clock.now += 320 * MS
    bench.run(1)
    assert bench.estimator.pushed == [0, 1, 2]
    assert bench.daemon.estimation.aligner.next_index == len(bench.conditioner.windows)


def test_status_reports_sources_links_windows_and_tasks(bench: Bench):
    bench.run(176)
    status = bench.sink.statuses[-1]
    assert status["samples"]["arm"]["lost"] == 0
    assert status["samples"]["arm"]["rejected"] == 0
    assert set(status["samples"]) == {"arm", "imu", "star_tracker"}
    assert status["links"]["imu"] == {"up": True, "losses": 0}
    assert status["slips"] == 0
    assert {"sync_arm", "drain", "hand_over"} <= set(status["tasks_us"])


def test_serial_bytes_read_at_an_early_wake_keep_that_stamp(bench: Bench):
    bench.daemon.step()
    bench.clock.wakes = [10**9 + MS]
    bench.clock.now = 10**9 + MS // 2
    bench.imu.queue = []
    original = bench.imu.read

    def read() -> list:
        if bench.clock.now == 10**9 + MS:
            bench.imu.put(b"abc")
        return original()

    bench.imu.read = read
    bench.daemon.step()
    assert [(c.t_ns, c.data) for c in bench.sink.chunks] == [(10**9 + MS, b"abc")]


def test_a_lost_port_is_an_event_and_comes_back_with_its_devices_started(arm: ArmProject):
    fresh: list[FakeCan] = []
    attempts: list[int] = []

    def opener() -> FakeCan:
        attempts.append(bench.clock.now)
        if len(attempts) < 3:
            raise PortError("still gone")
        fresh.append(FakeCan(bench.clock))
        return fresh[-1]

    bench = Bench(arm, can_openers={"arm": opener})
    bench.daemon.step()
    bench.can.broken = True
    for _ in range(1000):  # 2 s
        bench.daemon.step()
    assert bench.can.closed
    assert bench.sink.codes == ["PORT_LOST", "PORT_BACK"]
    assert len(attempts) == 3
    pauses = [attempts[1] - attempts[0], attempts[2] - attempts[1]]
    assert all(500 * MS <= pause <= 700 * MS for pause in pauses)
    assert [can_id for _, can_id, _ in fresh[0].written[:4]] == [0, 0, 0, 0x080]
    assert bench.daemon.status()["links"]["arm"] == {"up": True, "losses": 1}


def test_a_port_that_could_not_be_opened_does_not_stop_the_rest(arm: ArmProject):
    clock, sink = FakeClock(), KeepSink()
    daemon = Daemon(
        arm_config(arm),
        clock,
        Ports(can={"arm": FakeCan(clock)}, imu=None, star_tracker=None),
        sink,
        pipeline=Pipeline(conditioner=FakeConditioner(), estimator=FakeEstimator()),
    )
    for _ in range(500):
        daemon.step()
    assert daemon.status()["links"]["imu"] == {"up": False, "losses": 1}
    assert daemon.estimation.aligner.next_index > 0


def test_a_node_that_boots_again_is_started_again(bench: Bench):
    bench.run(4)
    bench.can.queue.append(CanFrame(bench.clock.now, 0x712, b"\0"))
    bench.daemon.step()
    assert bench.can.written[-1][1:] == (0, b"\x01\x12")


def test_commands_apply_between_two_windows_and_stop_ends_the_run(bench: Bench):
    bench.run(78)  # window 0 has been worked off
    bench.daemon.submit(Command(name=CommandName.RESET))
    assert bench.estimator.calls == ["push", "work", "reset"]
    assert bench.sink.commands[-1]["next_window"] == 1
    bench.daemon.submit(Command(name=CommandName.STOP))
    bench.daemon.run(lambda: False)
    assert bench.daemon.executive.slips.ticks == 78


@pytest.mark.parametrize(
    "error",
    [EstimatorError("diverged"), np.linalg.LinAlgError("singular"), OverflowError("too large")],
)
def test_a_failing_estimator_is_reset_and_reported(bench: Bench, error: Exception):
    def fail(_block: object) -> None:
        raise error

    bench.estimator.push = fail
    bench.run(82)
    assert bench.sink.codes == ["ESTIMATOR_RESET"]
    assert bench.estimator.calls[-1] == "reset"


def test_shutdown_settles_publishes_and_releases_everything(bench: Bench):
    bench.run(80)
    final = bench.daemon.shutdown()
    assert final is not None
    assert bench.estimator.calls[-2:] == ["work", "finish"]
    assert bench.sink.commands[-1] == {"command": "end", "next_window": 1}
    assert bench.sink.closed
    assert bench.can.closed
    assert bench.imu.closed


def test_shutdown_before_any_window_has_no_estimate(bench: Bench):
    bench.daemon.step()
    assert bench.daemon.shutdown() is None


def test_a_sent_frame_stands_before_what_was_stamped_after_its_send_began(bench: Bench):
    """A preempted send: the answer's stamp is older than the SYNC's own."""
    bench.daemon.step()
    write = bench.can.write

    def slow(can_id: int, data: bytes) -> CanFrame:
        began = bench.clock.now
        bench.clock.now += 300_000
        bench.can.queue.append(CanFrame(began - 5, 0x191, bytes(8)))
        bench.can.queue.append(CanFrame(began + 200_000, 0x192, bytes(8)))
        return write(can_id, data)

    bench.daemon.step()
    bench.can.write = slow
    bench.daemon.step()
    tail = bench.sink.frames[-3:]
    assert [f.can_id for f in tail] == [0x191, 0x080, 0x192]
    assert tail[2].t_ns == tail[1].t_ns


def test_at_rest_windows_are_stored_but_reach_no_estimator(bench: Bench):
    bench.daemon.submit(Command(name=CommandName.REST))
    bench.run(100)
    assert bench.estimator.pushed == []
    assert len(bench.sink.blocks) > 0
    bench.daemon.submit(Command(name=CommandName.RESUME))
    bench.run(100)
    assert len(bench.estimator.pushed) > 0
    assert bench.daemon.status()["identifying"]


def test_without_telemetry_nothing_is_handed_over(bench: Bench):
    bench.run(50)
    assert bench.sink.records == []


def test_the_newest_samples_are_handed_over_as_the_dictionary_lays_them_out(arm: ArmProject):
    arm.data["telemetry"] = {"port": 0, "science_rate_hz": 100.0}
    bench = Bench(arm)
    bench.run(51)
    layout = Layout(DICTIONARY.packet("science").fields[1:])
    told = [layout.unpack(record) for _, record in bench.sink.records]
    assert len(told) == 11
    assert told[-1]["joint_1_torque"] == pytest.approx(2.53, abs=0.031)
    assert told[-1]["joint_3_position"] == pytest.approx(1000 * 2**-24 * 2 * 3.141592653589793)
    assert told[-1]["joint_4_position"] == 0.0
    assert told[-1]["fresh"] == 0b111 << 8
    assert told[-1]["joint_time_s"] == pytest.approx(1.0 + 0.096)


def test_imu_and_attitude_samples_have_their_own_times_and_flags():
    science = Science()
    science.keep(imu_samples((3 * 10**9, 4 * 10**9, 0, (0.1, 0.2, 0.3), None)))
    science.keep(attitude_samples((5 * 10**9, 0, (0.0, 0.6, 0.0, 0.8))))
    layout = Layout(DICTIONARY.packet("science").fields[1:])
    told = layout.unpack(science.record(7.5))
    assert (told["gyro_time_s"], told["acc_time_s"], told["attitude_time_s"]) == (3.0, 0.0, 5.0)
    assert (told["gyro_y_rad_s"], told["attitude_w"], told["nis"]) == (0.2, 0.8, 7.5)
    assert told["fresh"] == 0b101
    assert layout.unpack(science.record(7.5))["fresh"] == 0
