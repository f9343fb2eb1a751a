"""Described devices beside the joints: wheels alone on a bus without SYNC, a shared message."""

from fsw.config import Config
from fsw.drivers.wire import CanFrame, frame_array
from fsw.estimation.channels import BusChannel
from fsw.exchange.sinks import CanTraffic
from tests.support.driver_configs import unit_on_bus
from tests.support.wheel_cases import config_with_wheels
from tests.unit.fsw.drivers.sources.test_described_wheels import (
    MESSAGES,
    PERIOD_NS,
    T0,
    report,
    signals,
)

COUNT = 40
BUS = {"name": "body", "rate_hz": 20.0, "sync": "none", "listen_only": True, "messages": MESSAGES}


def test_its_reports_are_read_and_the_first_begins_the_grid():
    data = config_with_wheels(wheel={"rate_hz": 20.0}).model_dump(mode="json")
    data["buses"].append(BUS)
    for k, wheel in enumerate(data["wheels"][:2]):
        wheel |= {"driver": "described", "node_id": None, "bus": "body", "signals": signals(k)}
        wheel["timing"] = {"by": "arrival", "sigma_s": 1e-4}
    config = Config.model_validate(data)
    channel = BusChannel(config, config.buses[-1])
    frames = [report(k, T0 + PERIOD_NS * i + k, 100) for i in range(COUNT) for k in range(2)]
    for part in (frames[:COUNT], frames[COUNT:]):
        channel.put(CanTraffic("body", frame_array(part)))
        assert channel.first_ns() == part[0].t_ns
        (wheels, _), (joints, _) = channel.decoded()
        assert (len(wheels.t_ns), len(joints.t_ns)) == (COUNT, 0)
    assert (channel.findings(), list(channel.events())) == ([], [])
    assert channel.counters["body"]["accepted"] == 2 * COUNT
    channel.watch(frames[-1].t_ns + 10**9, up=True)
    assert [found.fault for found in channel.findings()] == ["WHEEL_SILENT"] * 2
    (node,) = {own.bus for own in config.can_nodes}
    assert node == "arm"


def test_devices_of_two_kinds_may_share_a_message():
    data = config_with_wheels(wheel={"rate_hz": 20.0}).model_dump(mode="json")
    unit_on_bus(data)
    data["imu"]["rate_hz"] = 20.0
    use = {"speed": {"message": "unit", "signal": "rate_x"}}
    data["wheels"][0] |= {"driver": "described", "node_id": None, "signals": use}
    data["wheels"][0]["timing"] = {"by": "arrival", "sigma_s": 1e-4}
    config = Config.model_validate(data)
    channel = BusChannel(config, config.buses[0])
    frames = [CanFrame(T0 + PERIOD_NS * i, 0x300, bytes(6)) for i in range(COUNT)]
    channel.put(CanTraffic("arm", frame_array(frames)))
    (wheels, _), (unit, _), (joints, _) = channel.decoded()
    assert (len(wheels), len(unit), len(joints)) == (COUNT, COUNT, 0)
    assert channel.counters["arm"]["other_frames"] == 0
