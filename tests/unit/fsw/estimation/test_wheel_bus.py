"""A bus with described wheels alone, on which nobody sends SYNC."""

from fsw.config import Config
from fsw.drivers.wire import frame_array
from fsw.estimation.channels import BusChannel
from fsw.exchange.sinks import CanTraffic
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
    (node,) = {own.bus for own in config.can_nodes}
    assert node == "arm"
