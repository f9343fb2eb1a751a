"""The simulated devices' end of a real bus."""

import select

import can
import pytest

from hil.devices import realtime
from hil.devices.frame_port import SyncTap
from hil.devices.plant_file import BusLink
from hil.faults.real_bus import Babble, cable, running

NEAR, FAR = "vxcan0", "vxcan1"
SYNC_ID, NMT_ID, SDO_ID, HEARTBEAT_ID = 0x080, 0x000, 0x611, 0x701


class Listener:
    """Stands for the plant: keeps what it is told and answers nothing."""

    def __init__(self):
        self.heard = []

    def on_frame(self, t_ns, can_id, data, _bus, _line):
        self.heard.append((t_ns, can_id, data))
        return []

    def sync_producer(self, _t_ns):
        return None


@pytest.fixture
def ends(monkeypatch):
    monkeypatch.setattr(realtime, "monotonic_less_realtime_ns", lambda: 0)
    plant = Listener()
    link = BusLink(name="arm", interface="socketcan", channel=FAR, stamped_at=NEAR)
    with cable(NEAR, FAR):
        end = realtime.BusEnd(link, plant, realtime.Stalls())
        options = {"interface": "socketcan", "channel": NEAR}
        with can.Bus(**options, receive_own_messages=True) as host:
            yield host, end, plant
        end.close()


def send(host, can_id, data=b""):
    host.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
    return host.recv(5.0)


def test_a_sync_has_the_time_of_its_stamp_at_the_host_s_end(ends):
    host, end, plant = ends
    stamps_ns = []
    for k in range(500):
        stamps_ns.append(round(send(host, SYNC_ID, bytes([k % 240 + 1])).timestamp * 1e9))
        if k % 3 == 0:
            end.receive()
    end.receive()
    assert [t_ns for t_ns, _, _ in plant.heard] == stamps_ns


def test_a_sync_that_only_the_devices_end_heard_has_its_stamp_there(ends):
    _, end, plant = ends
    with can.Bus(interface="socketcan", channel=FAR) as repeater:
        end._port._tap.close()
        end._port._tap = SyncTap("vcan0")
        repeater.send(can.Message(arbitration_id=SYNC_ID, data=[7], is_extended_id=False))
        assert select.select([end], (), (), 5.0)[0] == [end]
    end.receive()
    assert [data for _, _, data in plant.heard] == [b"\x07"]


def test_a_node_hears_the_host_and_no_babble(ends):
    host, end, plant = ends
    babble = Babble(FAR, 0x020, 5000.0, 1)
    with running(babble):
        assert select.select([end], (), (), 0.3)[0] == []
    assert babble.sent > 500
    for can_id in (NMT_ID, SDO_ID, HEARTBEAT_ID, 0x191, 0x591):
        send(host, can_id, b"\x01\x11")
    end.receive()
    assert [can_id for _, can_id, _ in plant.heard] == [NMT_ID, SDO_ID, HEARTBEAT_ID]


def test_a_disturbance_that_ends_early_is_told():
    with pytest.raises(OSError, match="No such device"), running(Babble("vcan9", 0x020, 1.0, 1)):
        pass
