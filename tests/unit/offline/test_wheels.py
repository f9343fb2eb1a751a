"""Commands on a robot with reaction wheels."""

import struct

from fsw.config import Config
from fsw.drivers.wire import CanFrame, frame_array
from fsw.exchange.sinks import CanTraffic
from offline.excite import what_stands_still
from offline.nodes import Nodes
from offline.replay import topics_of
from tests.support.driver_configs import unit_on_bus
from tests.support.wheel_cases import config_with_wheels


def test_wheel_nodes_are_no_strangers_in_a_recording() -> None:
    nodes = Nodes(config_with_wheels())
    data = struct.pack("<ihBB", 0, 0, 9, 1)
    frames = [CanFrame(1, 0x180 + node, data) for node in (0x11, 0x21, 0x24)]
    nodes.put(CanTraffic("arm", frame_array(frames)))
    assert not any("are not nodes" in line for line in nodes.findings())
    nodes.put(CanTraffic("arm", frame_array([CanFrame(1, 0x1A5, data)])))
    assert "0x25" in nodes.findings()[0]


def test_a_described_device_is_no_stranger_beside_tailored_nodes() -> None:
    data = config_with_wheels().model_dump(mode="json")
    signals = [{"name": "speed", "start": 0, "bits": 16, "number": "signed", "unit": "rpm"}]
    data["buses"][0]["messages"] = [{"name": "w", "id": 0x1A5, "length": 2, "signals": signals}]
    use = {"speed": {"message": "w", "signal": "speed"}}
    timing = {"by": "arrival", "sigma_s": 1e-4}
    own = {"driver": "described", "node_id": None, "signals": use, "timing": timing}
    data["wheels"][3] |= own
    nodes = Nodes(Config.model_validate(data))
    nodes.put(CanTraffic("arm", frame_array([CanFrame(1, k, bytes(2)) for k in (0x1A5, 0x725)])))
    assert not any("are not nodes" in line for line in nodes.findings())
    nodes.put(CanTraffic("arm", frame_array([CanFrame(1, 0x1A6, bytes(2))])))
    assert "0x26" in nodes.findings()[0]


def test_what_is_on_a_bus_is_replayed_from_it_or_from_samples() -> None:
    bare = config_with_wheels().model_copy(update={"joints": ()})
    for held in (["/can/arm", "/serial/imu"], ["/samples/wheels", "/samples/imu"]):
        assert topics_of(bare, held) == held
    data = config_with_wheels().model_dump(mode="json")
    unit_on_bus(data)
    config = Config.model_validate(data)
    assert topics_of(config, ["/can/arm"]) == ["/can/arm"]
    needed = [f"/samples/{name}" for name in ("joints", "wheels", "imu")]
    assert topics_of(config, ["/samples/joints"]) == needed


def test_a_plan_says_that_wheels_stand_still() -> None:
    assert "as if they stood still" in what_stands_still(config_with_wheels(), ())[0]
