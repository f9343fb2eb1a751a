"""The walk of a torque begins at its frame, passes the rooms in order and ends in a packet."""

from __future__ import annotations

import pytest

from hil.evidence import walks


@pytest.mark.slow
def test_a_torque_is_followed_from_its_frame_through_every_room_to_its_packet() -> None:
    walk = walks.torque_walk()
    way = walk.way()
    rooms = [name.split(":")[0] for name in way]
    assert way[-1].startswith(walks.END)
    assert {"JointSamples", "Window", "Block", "Estimate"} <= set(walk.forms)
    assert set(way) <= set(walk.hops)
    marks = ("fsw.drivers", "fsw.scheduler", "fsw.estimators", "fsw.exchange", "fsw.telemetry")
    first = [next(k for k, room in enumerate(rooms) if room.startswith(mark)) for mark in marks]
    assert first[0] < first[1] < first[2] < first[4]
