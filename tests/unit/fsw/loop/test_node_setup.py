"""Setup of CANopen nodes by SDO, against a node of the library canopen on a bus in memory."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import canopen
import pytest

from fsw.clock import MonotonicClock
from fsw.config import Config, JointConfig
from fsw.drivers.codecs.sdo import compared, download, upload, value_of, written
from fsw.drivers.layout.files import read_mappings
from fsw.drivers.layout.joints import layouts_of
from fsw.drivers.ports.can_bus import open_can
from fsw.drivers.sources.described import DescribedBusSource
from fsw.drivers.wire import PdoMapping
from fsw.errors import ConfigError
from fsw.loop.ports import Ports
from fsw.loop.wiring import bus_input
from fsw.messages import Event
from tests.support.driver_configs import bus_config, joint_config
from tests.support.own_wires import EDS

NODE = 5
FOREIGN = EDS.replace("DefaultValue=0x60640020", "DefaultValue=0x60770010").replace(
    "DefaultValue=0x60770010\n[6041]", "DefaultValue=0x60640020\n[6041]"
)
AS_DESCRIBED = [0x60410010, 0x60640020, 0x60770010]


class Sink:
    def __init__(self) -> None:
        self.items: list[Any] = []

    def put(self, item: Any) -> None:
        self.items.append(item)

    @property
    def events(self) -> list[tuple[str, str]]:
        return [(item.code, item.text) for item in self.items if isinstance(item, Event)]


class Bench:
    """A bus of the daemon and a drive of canopen, on python-can's bus in memory."""

    def __init__(self, folder: Path, drive: str, pdo: str, channel: str, **bus: Any) -> None:
        (folder / "drive.eds").write_text(EDS)
        (folder / "foreign.eds").write_text(drive)
        counts = {"unit": "counts", "counts_per_rev": 4096}
        torque = {"unit": "permille", "rated_torque_nm": 20.0}
        own = {
            "driver": "described",
            "node_id": NODE,
            "description": "drive.eds",
            "pdo": pdo,
            "speed_limit_rad_s": 3.0,
            "signals": {
                "position": {"message": "TPDO1", "signal": "0x6064"} | counts,
                "torque": {"message": "TPDO1", "signal": "0x6077"} | torque,
            },
            "timing": {"by": "last_sync"},
        }
        keys = {"interface": "virtual", "channel": channel, "rate_hz": 100.0}
        self.bus = bus_config(**(keys | {"sync_counter_max": 0} | bus))
        joint = JointConfig(**(joint_config(1).model_dump() | own))
        config = Config.model_construct(
            buses=(self.bus,), joints=(joint,), wheels=(), thrusters=()
        ).read_from(b"", folder, "c")
        clock = MonotonicClock()
        self.port = open_can(self.bus, clock)
        self.seen = can.Bus(interface="virtual", channel=channel)
        self.network = canopen.Network(can.Bus(interface="virtual", channel=channel))
        self.network.connect()
        self.drive = canopen.LocalNode(NODE, str(folder / "foreign.eds"))
        self.network.add_node(self.drive)
        self.input = bus_input(
            config, self.bus, clock, Ports(can={self.bus.name: self.port}, imu=None)
        )
        self.source = DescribedBusSource(self.bus, [(0, joint)], layouts_of(config, self.bus))
        self.sink = Sink()

    def run(self, until: str, most_s: float = 20.0) -> None:
        """Run the bus until an event of a code."""
        end_s = time.monotonic() + most_s
        while not any(code == until for code, _ in self.sink.events):
            assert time.monotonic() < end_s, (until, self.sink.events)
            self.step()

    def step(self) -> None:
        time.sleep(1e-3)
        self.input.drain()
        self.input.take()
        self.input.read()
        self.input.order()
        self.input.hand_over(self.sink)

    def frames(self) -> list[tuple[int, bytes]]:
        """Return what anybody has sent so far."""
        found = []
        while (message := self.seen.recv(0.0)) is not None:
            found.append((message.arbitration_id, bytes(message.data)))
        return found

    def close(self) -> None:
        self.network.disconnect()
        self.seen.shutdown()
        self.port.close()


@pytest.fixture
def bench(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Any]:
    made: list[Bench] = []

    def make(drive: str, pdo: str, **bus: Any) -> Bench:
        made.append(Bench(tmp_path, drive, pdo, f"{request.node.name}{len(made)}", **bus))
        return made[-1]

    yield make
    for own in made:
        own.close()


def test_a_foreign_mapping_is_written_read_back_started_and_read(bench):
    own = bench(FOREIGN, "written")
    own.input.start_nodes()
    own.run("NODE_SET_UP")
    found = [own.drive.sdo[0x1A00][k].raw for k in range(4)]
    assert found == [3, *AS_DESCRIBED]
    sent = own.frames()
    assert sent[0] == (0x000, bytes((0x80, NODE)))  # pre-operational
    writes = [data.hex() for word, data in sent if word == 0x600 + NODE and data[0] != 0x40]
    assert writes == [
        "2300180185010080",  # the PDO is made invalid
        "2f00180201000000",
        "2b00180300000000",
        "2b00180500000000",
        "2f001a0000000000",  # its mapping emptied, filled and counted
        "23001a0110004160",
        "23001a0220006460",
        "23001a0310007760",
        "2f001a0003000000",
        "2300180185010000",
    ]
    assert (0x000, bytes((0x01, NODE))) in sent
    for _ in range(1000):
        if own.drive.nmt.state == "OPERATIONAL":
            break
        time.sleep(1e-3)
    assert own.drive.nmt.state == "OPERATIONAL"
    own.drive.tpdo.read(from_od=False)
    own.input.send_sync()
    pdo = own.drive.tpdo[1]
    pdo[0x6041].raw, pdo[0x6064].raw, pdo[0x6077].raw = 0x27, 1024, 500
    pdo.transmit()
    for _ in range(20):
        own.step()
    frames = [item.frames for item in own.sink.items if hasattr(item, "frames")]
    samples = [own.source.feed(part) for part in frames]
    (position,) = [float(p) for part in samples for p in part.position_rad]
    assert position == pytest.approx(2 * 3.141592653589793 * 0.25)


def test_a_drive_as_described_is_started_and_nothing_is_written(bench):
    own = bench(EDS, "checked")
    own.input.start_nodes()
    own.run("NODE_SET_UP")
    requests = [data for word, data in own.frames() if word == 0x600 + NODE]
    assert {data[0] for data in requests} == {0x40}


def test_a_drive_that_differs_is_refused_in_one_line_and_not_started(bench):
    own = bench(FOREIGN, "checked")
    own.input.start_nodes()
    own.run("NODE_DIFFERS")
    ((_, text),) = own.sink.events
    assert text.endswith(
        "0x1a00:02 is 0x60770010 in the drive and 0x60640020 in the description; it is not started"
    )
    own.drive.nmt.send_command(0)
    own.network.send_message(0x700 + NODE, b"\x7f")  # it waits, and is not started all the same
    for _ in range(30):
        own.step()
    assert (0x000, bytes((0x01, NODE))) not in own.frames()
    own.network.send_message(0x700 + NODE, b"\x00")  # exchanged, or reset: it is looked at again
    own.run_again = len(own.sink.events)
    while len(own.sink.events) == own.run_again:
        own.step()
    assert own.sink.events[-1][0] == "NODE_DIFFERS"


def test_a_node_that_is_absent_is_told(bench, monkeypatch):
    monkeypatch.setattr("fsw.loop.node_setup.WAIT_NS", 10_000_000)
    own = bench(EDS, "written")
    own.network.disconnect()
    own.input.start_nodes()
    own.run("NODE_DIFFERS")
    assert "does not answer SDO" in own.sink.events[0][1]
    own.network = canopen.Network(can.Bus(interface="virtual", channel=own.bus.channel))
    own.network.connect()


def test_who_only_listens_sends_nothing(bench):
    own = bench(FOREIGN, "trusted", listen_only=True, sync="consumer")
    own.input.start_nodes()
    own.network.send_message(0x700 + NODE, b"\x00")
    for _ in range(30):
        own.step()
        own.input.send_sync()
    assert own.frames() == [(0x700 + NODE, b"\x00")]


PDO = PdoMapping(number=1, cob_id=0x181, transmission=1, entries=(0x60410010, 0x606C0020))


def answers(dialogue: Any, objects: dict[tuple[int, int], int], fixed: bool) -> str:
    """Serve a dialogue from a dictionary of objects; `fixed`: the count cannot be written."""
    request = next(dialogue)
    try:
        while True:
            index, sub = int.from_bytes(request[1:3], "little"), request[3]
            head = request[1:4]
            if request[0] == 0x40:
                reply = b"\x43" + head + objects[index, sub].to_bytes(4, "little")
            elif fixed and (index, sub) == (0x1A00, 0):
                reply = b"\x80" + head + (0x06010002).to_bytes(4, "little")
            elif (index, sub) not in objects:
                reply = b"\x80" + head + (0x06090011).to_bytes(4, "little")
            else:
                objects[index, sub] = int.from_bytes(request[4:], "little")
                reply = b"\x60" + head + bytes(4)
            request = dialogue.send(reply)
    except StopIteration as end:
        return str(end.value)


def drive_of(count: int) -> dict[tuple[int, int], int]:
    objects = {(0x1800, 1): 0x181, (0x1800, 2): 255, (0x1A00, 0): count}
    return objects | {(0x1A00, k): 0x10010008 for k in range(1, count + 1)}


def test_unused_entries_of_a_fixed_mapping_are_filled_with_zeros():
    objects = drive_of(4)
    assert answers(written([PDO]), objects, fixed=True) == ""
    assert [objects[0x1A00, k] for k in range(5)] == [4, *PDO.entries, 0, 0]
    assert objects[0x1800, 2] == 1


def test_a_drive_without_inhibit_time_takes_none():
    assert answers(written([PDO]), drive_of(2), fixed=False) == ""


def test_a_drive_that_refuses_is_told_with_its_abort_code():
    objects = drive_of(1)
    assert answers(written([PDO]), objects, fixed=False) == (
        "0x1a00:02 cannot be written: abort 0x06090011"
    )


def test_a_drive_that_forbids_rtr_is_as_described():
    objects = drive_of(2) | {(0x1800, 1): 0x40000181, (0x1800, 2): 1}
    objects |= {(0x1A00, k + 1): own for k, own in enumerate(PDO.entries)}
    assert answers(compared([PDO]), objects, fixed=False) == ""


@pytest.mark.parametrize(
    ("request_", "wire"),
    [
        (download(0x1A00, 0, 0, 1), "2F001A0000000000"),
        (download(0x1A00, 1, 0x60410010, 4), "23001A0110004160"),
        (download(0x1A00, 2, 0x606C0020, 4), "23001A0220006C60"),
        (upload(0x6077, 0), "4077600000000000"),
    ],
)
def test_bytes_of_real_masters(request_, wire):
    assert request_ == bytes.fromhex(wire)


@pytest.mark.parametrize(
    ("reply", "value"),
    [("4B77600001000000", 1), ("4F00180201FFFFFF", 1), ("43011A0010004160", 0x60410010),
     ("8000180200000206", None), ("4100180204000000", None), ("43", None)],
)  # fmt: skip
def test_answers(reply, value):
    assert value_of(bytes.fromhex(reply)) == value


def test_the_mapping_of_a_file(tmp_path):
    path = tmp_path / "drive.eds"
    path.write_text(EDS)
    (found,) = read_mappings(path, 3, {"TPDO1"})
    assert (found.cob_id, found.transmission, list(found.entries)) == (0x183, 1, AS_DESCRIBED)
    with pytest.raises(ConfigError, match="object 0x1a01:00 is mapped"):
        read_mappings(path, 3, {"TPDO2"})
