"""Commands on a robot with reaction wheels."""

from __future__ import annotations

import struct

import pytest

from fsw.commands.check_recording import _Nodes
from fsw.commands.excite import with_all_still
from fsw.drivers.wire import CanFrame, frame_array
from fsw.exchange.sinks import CanTraffic
from tests.support.wheel_cases import config_with_wheels


def test_wheel_nodes_are_no_strangers_in_a_recording() -> None:
    nodes = _Nodes(config_with_wheels())
    data = struct.pack("<ihBB", 0, 0, 9, 1)
    frames = [CanFrame(1, 0x180 + node, data) for node in (0x11, 0x21, 0x24)]
    nodes.put(CanTraffic("arm", frame_array(frames)))
    assert nodes.strangers() == []
    nodes.put(CanTraffic("arm", frame_array([CanFrame(1, 0x1A5, data)])))
    assert "0x25" in nodes.strangers()[0]


def test_a_motion_is_planned_with_the_wheels_still_and_says_so(
    capsys: pytest.CaptureFixture[str],
) -> None:
    config = config_with_wheels()
    assert with_all_still(config).wheels == ()
    assert "as if they stood still" in capsys.readouterr().err
    plain = with_all_still(config)
    assert with_all_still(plain) is plain
