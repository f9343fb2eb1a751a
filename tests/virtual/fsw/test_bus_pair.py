"""Two redundant buses in the wiring: what is sent where, and when the daemon changes bus."""

import itertools
import struct

import pytest

from fsw.config import load
from fsw.drivers.wire import CanFrame
from fsw.errors import ConfigError
from fsw.estimators.pipeline import Pipeline
from fsw.loop.ports import Ports
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

HEARTBEAT = (0x701, b"\x05")
PAIR = {"channel": "second", "lost_after_s": 0.1, "nodes_toggle_s": 0.3}


def pair_of_buses(arm: ArmProject, **changes):
    bus = arm.data["buses"][0]
    arm.data["buses"] = [bus | {"heartbeat_s": 0.1, "redundant": PAIR | changes}]


class Pair:
    """Three joints on a pair of buses at 250 Hz, ticks at 500 Hz; nodes answer on `line`."""

    def __init__(self, arm: ArmProject) -> None:
        pair_of_buses(arm)
        self.clock, self.sink = FakeClock(10**9), KeepSink()
        self.cans = (FakeCan(self.clock), FakeCan(self.clock))
        self.line: int | None = 0
        self.daemon = Daemon(
            arm_config(arm),
            self.clock,
            Ports(
                can=dict(zip(("arm", "arm.redundant"), self.cans, strict=True)),
                imu=FakeSerial(self.clock, (7,)),
                star_tracker=FakeSerial(self.clock),
                can_openers={"arm": self._open},
            ),
            self.sink,
            pipeline=Pipeline(conditioner=FakeConditioner(), estimator=FakeEstimator()),
        )

    def _open(self) -> FakeCan:
        return FakeCan(self.clock)

    def run(self, ticks: int) -> None:
        for _ in range(ticks):
            self.daemon.step()
            for line, can in enumerate(self.cans):
                syncs = [data for t, i, data in can.written if i == 0x080 and t == self.clock.now]
                if line == self.line and syncs:
                    pdo = struct.pack("<ihBB", 1000, 250, 0x09, syncs[0][0])
                    can.queue += [
                        CanFrame(self.clock.now + MS, 0x180 + n, pdo) for n in (0x11, 0x12, 0x13)
                    ]

    @property
    def codes(self) -> list[str]:
        """Codes of the events about buses and ports; the sensors' own health is not asked here."""
        return [code for code in self.sink.codes if code.startswith(("BUS_SW", "PORT_", "CAN_"))]

    def status(self, part: str):
        return self.daemon.status()[part]


@pytest.fixture
def pair(arm: ArmProject) -> Pair:
    return Pair(arm)


def sent(can: FakeCan, can_id: int) -> list[int]:
    return [t_ns for t_ns, i, _ in can.written if i == can_id]


def test_sync_and_heartbeat_go_out_on_the_active_bus_alone(pair: Pair):
    pair.run(500)
    assert len(sent(pair.cans[0], 0x080)) == 250
    beats = sent(pair.cans[0], 0x701)
    assert {b - a for a, b in itertools.pairwise(beats)} == {100 * MS}
    assert [w[1:] for w in pair.cans[0].written].count(HEARTBEAT) == 10
    assert pair.cans[1].written == []
    assert pair.status("links") | {"imu": 0, "star_tracker": 0} == {
        "arm": {"up": True, "losses": 0},
        "arm.redundant": {"up": True, "losses": 0},
        "imu": 0,
        "star_tracker": 0,
    }


def test_when_the_nodes_fall_silent_the_other_bus_is_taken_with_the_next_counter(pair: Pair):
    pair.run(500)
    pair.line = 1
    pair.run(500)
    assert pair.codes == ["BUS_SWITCHED"]
    assert pair.status("buses")["arm"]["active"] == "redundant"
    first = pair.cans[1].written[:4]
    assert [i for _, i, _ in first] == [0, 0, 0, 0x701]  # start of every node, then the heartbeat
    counters = [data[0] for can in pair.cans for _, can_id, data in can.written if can_id == 0x080]
    assert counters == [k % 240 + 1 for k in range(500)]
    samples = pair.status("samples")["arm"]
    assert samples["rejected"] == 0
    assert 3 * 25 <= samples["lost"] < 3 * 30  # 0.1 s of silence, and the tick of the change
    assert samples["received"] + samples["lost"] >= 3 * 470


def test_a_port_that_fails_is_left_at_once_and_opened_again_as_the_idle_one(pair: Pair):
    pair.run(500)
    pair.cans[0].broken = True
    pair.line = 1
    pair.run(500)
    assert pair.codes == ["PORT_LOST", "BUS_SWITCHED", "PORT_BACK"]
    assert pair.status("buses")["arm"]["switches"] == 1
    assert pair.status("links")["arm"] == {"up": True, "losses": 1}
    assert pair.status("samples")["arm"]["lost"] <= 3 * 3


def test_frames_of_the_idle_bus_never_become_samples(pair: Pair):
    pair.run(100)
    pair.line = None
    pair.run(15)  # the batch in progress
    before = pair.status("samples")["arm"]
    pdo = struct.pack("<ihBB", 1000, 250, 0x09, 50)
    pair.cans[1].queue += [CanFrame(pair.clock.now, 0x191, pdo)] * 20
    pair.run(15)
    after = pair.status("samples")["arm"]
    assert after["received"] == before["received"]
    assert after["rejected"] == before["rejected"]
    assert pair.cans[1].queue == []


@pytest.mark.parametrize(
    ("changes", "bus", "words"),
    [
        ({}, {"heartbeat_s": None}, "buses.0.redundant: needs heartbeat_s"),
        ({}, {"sync": "consumer"}, "buses.0.redundant: needs sync: producer"),
        ({"nodes_toggle_s": 0.14}, {}, "buses.0.redundant.nodes_toggle_s: 0.14 must be at least"),
        ({"lost_after_s": 0.019}, {}, "buses.0.redundant.lost_after_s: 0.019 must be at least 5"),
        ({"channel": "arm"}, {}, "buses.0.channel and buses.0.redundant.channel"),
    ],
)
def test_a_pair_that_cannot_work_is_refused(arm: ArmProject, changes, bus, words):
    pair_of_buses(arm, **changes)
    arm.data["buses"][0] |= bus
    with pytest.raises(ConfigError) as caught:
        load(arm.write())
    assert words in str(caught.value)


def test_lost_and_unsent_frames_are_told_once_a_second(pair: Pair):
    pair.run(10)
    for _ in range(5):
        pair.cans[0].dropped = 7
        pair.run(10)
    assert pair.codes == ["CAN_OVERFLOW"]
    pair.cans[0].full = True
    pair.run(5)
    pair.cans[0].full = False
    pair.run(600)
    assert pair.codes == ["CAN_OVERFLOW", "CAN_OVERFLOW", "CAN_UNSENT"]
    texts = [event.text for event in pair.sink.events if event.code == "CAN_OVERFLOW"]
    assert "28 received frames found no room (35 in all)" in texts[1]
    assert pair.status("buses")["arm"]["overflow"] == 35
    assert pair.status("buses")["arm"]["unsent"] >= 2


def test_a_sync_that_waits_to_be_fed_is_followed_by_the_next_counter(pair: Pair):
    (bus,) = pair.daemon.loop._inputs.buses
    for _ in range(3):
        bus.send_sync()
    bus.drain()
    bus.hand_over(pair.sink)
    bus.send_sync()
    assert [data for _, i, data in pair.cans[0].written if i == 0x080] == [
        b"\1",
        b"\2",
        b"\3",
        b"\4",
    ]
    pair.cans[0].full = True
    bus.send_sync()
    pair.cans[0].full = False
    bus.send_sync()
    assert pair.cans[0].written[-1][2] == b"\5"  # the one that was not sent is no gap


def test_frames_that_waited_since_before_the_start_do_not_make_a_bus_heard(pair: Pair):
    old = CanFrame(pair.clock.now - 500 * MS, 0x711, b"\x05")
    pair.cans[0].queue.append(old)
    pair.line = None
    pair.run(345)  # 0.69 s: the long patience is 0.1 s + 2 x 0.3 s
    assert pair.codes == []
    pair.run(10)
    assert pair.codes == ["BUS_SWITCHED"]
