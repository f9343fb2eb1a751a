"""The slave's side of ECSS-E-ST-50-15C: times and counts follow from its four parameters."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.devices.bus_toggle import BusToggle
from hil.devices.canopen import JointNode
from hil.world.sensor_config import BusToggleConfig

MS = 1_000_000


def toggle(ttoggle: int = 2, ntoggle: int = 3, consumer_ms: int = 100) -> BusToggle:
    config = BusToggleConfig(
        ttoggle=ttoggle, ntoggle=ntoggle, consumer_heartbeat_s=1e-3 * consumer_ms
    )
    made = BusToggle(config)
    made.power_on(0)
    return made


def test_without_a_heartbeat_the_node_toggles_ntoggle_times_and_stays():
    node = toggle()
    lines = []
    for t_ms in range(0, 2000, 50):
        node.advance(t_ms * MS)
        lines.append(node.line)
    # toggles at 200, 400 and 600 ms
    assert lines == [0] * 4 + [1] * 4 + [0] * 4 + [1] * 28
    assert (node.ctoggle, node.bdefault) == (3, 1)
    node.power_on(3000 * MS)
    assert (node.line, node.ctoggle) == (1, 0)


def test_a_heartbeat_keeps_the_node_and_one_missed_does_not_move_it():
    node = toggle()
    for t_ms in (100, 200, 390, 580):
        node.advance(t_ms * MS)
        node.heard(t_ms * MS)
    node.advance(779 * MS)
    assert (node.line, node.ctoggle) == (0, 0)
    node.advance(780 * MS)
    assert (node.line, node.ctoggle) == (1, 1)
    node.heard(800 * MS)
    assert (node.bdefault, node.ctoggle) == (1, 0)


def test_a_node_that_had_given_up_follows_the_heartbeat_again():
    node = toggle(ntoggle=1)
    node.advance(5000 * MS)
    assert node.line == 1
    node.heard(5000 * MS)
    node.advance(5200 * MS)
    assert node.line == 0


@given(st.integers(1, 10), st.integers(1, 20), st.integers(1, 500), st.integers(0, 100_000))
def test_the_bus_and_the_count_are_a_function_of_time(ttoggle, ntoggle, consumer_ms, t_ms):
    node = toggle(ttoggle, ntoggle, consumer_ms)
    for part in (t_ms // 3, t_ms // 2, t_ms):
        node.advance(part * MS)
    count = min(int(t_ms // (ttoggle * consumer_ms)), ntoggle)
    assert (node.ctoggle, node.line) == (count, count % 2)


@pytest.mark.parametrize(
    ("index", "subindex", "value"),
    [(0x2000, 0, 4), (0x2000, 1, 0), (0x2000, 2, 2), (0x2000, 3, 3), (0x2000, 4, 1),
     (0x1016, 1, 0x0001_0064)],
)  # fmt: skip
def test_the_objects_are_read_by_sdo(index, subindex, value):
    node = JointNode(node_id=0x11, joint=1, toggle=toggle())
    node.toggle.advance(200 * MS)
    reply = node.on_sdo(struct.pack("<BHB", 0x40, index, subindex) + bytes(4))
    assert reply[0] >> 5 == 2
    assert int.from_bytes(reply[4:], "little") == value
