"""A configuration with a feed is checked: each fault is one line with key, value and bound."""

import pytest

from fsw.checks.configuration import missing_devices, validate, validate_ports
from fsw.config import load
from fsw.errors import ConfigError
from offline.check_recording import _advice
from offline.describe import describe
from offline.replay import topics_of
from tests.support.check_cases import assert_named, fault
from tests.support.driver_configs import unit_on_bus
from tests.support.feed_cases import KEY, on_feed
from tests.support.keys import write_key


def refused(arm) -> str:
    with pytest.raises(ConfigError) as caught:
        load(arm.write())
    (line,) = str(caught.value).splitlines()
    return line


@pytest.mark.parametrize("everything", [False, True])
def test_a_feed_is_a_device_that_can_be_run_and_replayed(arm, everything):
    config = load(on_feed(arm, everything=everything).write())
    problem, warnings = validate(config)
    validate_ports(config)
    assert warnings == []
    text = describe(config, problem)
    assert "arm: feed of source 7 at UDP 127.0.0.1:45454, 250 Hz, clock monotonic" in text
    assert "joints in order axis1, axis2, axis3" in text
    devices = [] if everything else ["/serial/imu", "/serial/star_tracker"]
    assert topics_of(config, ["/serial/arm"]) == ["/serial/arm", *devices]
    assert ("imu: samples on arm" in text) is everything


def test_the_rate_of_a_feed_is_not_bound_to_the_loops(arm):
    on_feed(arm).data["buses"][0]["rate_hz"] = 1000.0
    assert load(arm.write()).scheduler.tick_rate_hz == 500.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"interface": "socketcan"}, ("buses.0.interface", "socketcan", "samples")),
        ({"channel": "192.168.0.1"}, ("buses.0.feed.key_file", "192.168.0.1", "missing")),
        ({"channel": "0.0.0.0"}, ("buses.0.feed.key_file", "0.0.0.0", "missing")),
        ({"channel": "localhost"}, ("buses.0.channel", "localhost", "numeric")),
        ({"heartbeat_s": 0.1}, ("buses.0.heartbeat_s", "left out")),
        ({"name": "imu"}, ("buses.0.name", "imu")),
        ({"feed": {"source": -1}}, ("buses.0.feed.source", "-1", "0")),
        ({"feed": {"source": 7, "clock": "gps"}}, ("buses.0.feed.clock", "gps", "tai")),
        ({"feed": {"source": 7, "key_file": "k"}}, ("buses.0.feed.clock", "monotonic", "unix")),
    ],
)
def test_a_feed_that_cannot_work_is_refused(arm, changes, words):
    on_feed(arm).data["buses"][0] |= changes
    for joint in arm.data["joints"]:
        joint["bus"] = arm.data["buses"][0]["name"]
    assert_named(refused(arm), *words)


def test_devices_and_feeds_must_suit_each_other(arm):
    joint = on_feed(arm).data["joints"][1]
    joint["node_id"] = 17
    assert_named(refused(arm), "joints.1.node_id", "17", "left out")
    del joint["driver"]
    assert_named(refused(arm), "joints.1.driver", "canopen", "samples")
    del joint["node_id"]
    assert_named(refused(arm), "joints.1.node_id", "missing", "canopen")
    joint["driver"] = "samples"
    arm.data["imu"]["bus"] = "arm"
    assert_named(refused(arm), "imu.driver", "stim300", "arm")
    arm.data["imu"] |= {"driver": "samples", "bus": "leg"}
    assert_named(refused(arm), "imu.bus", "leg", "arm")


def test_a_feed_that_no_device_uses_is_refused(arm):
    buses = on_feed(arm).data["buses"]
    buses.append(buses[0] | {"name": "spare", "port": 45455})
    assert_named(refused(arm), "buses.1.feed", "spare")


def test_a_key_must_be_private_and_whole(arm):
    on_feed(arm, clock="unix", key_file="feed.key").data["buses"][0]["channel"] = "192.168.0.1"
    validate(load(arm.write()))
    path = arm.folder / "feed.key"
    write_key(path, KEY, 0o644)
    assert_named(fault(arm), "buses.0.feed.key_file", "0644", "0600")
    write_key(path, KEY[:31])
    assert_named(fault(arm), "buses.0.feed.key_file", "32 bytes")
    path.unlink()
    assert_named(fault(arm), "buses.0.feed.key_file", str(path))


def test_a_unix_sockets_folder_must_exist(arm):
    bus = on_feed(arm).data["buses"][0]
    del bus["port"]
    bus["channel"] = "none/arm.sock"
    (line,) = [words for words in missing_devices(load(arm.write())) if "buses" in words]
    assert_named(line, "buses.0.channel", "none", "does not exist")


def test_samples_without_a_feed_are_of_recordings_only(arm):
    del on_feed(arm).data["buses"][0]["feed"]
    arm.data["star_tracker"] |= {"driver": "samples"}
    assert_named(fault(arm, validate_ports), "buses.0.interface", "star_tracker.driver", "a feed")


def test_a_held_arm_on_a_feed_needs_as_many_windows_as_any_other_that_flies(arm):
    on_feed(arm).data["base"] = {"motion": "clamped", "gravity_B_m_s2": [0.0, 0.0, -9.81]}
    assert load(arm.write()).estimator.settle_blocks == 25


def test_what_gives_nothing_is_compared_with_what_sends(arm):
    counts = {"accepted": 0, "received_bytes": 9}
    status = {"samples": {"arm": counts, "imu": counts}, "lacks": {}}
    config = load(arm.write())
    assert "node numbers" in _advice("arm", status, config)
    assert "imu.baud_rate" in _advice("imu", status, config)
    unit_on_bus(arm.data)
    config = load(arm.write())
    assert "node numbers" in _advice("arm", status, config)
    assert "compare imu.signals and imu.timing" in _advice("imu", status, config)


def test_a_feed_that_gives_nothing_is_compared_with_its_sender(arm):
    status = {"samples": {"arm": {"accepted": 0, "received_bytes": 9}}, "lacks": {}}
    assert "buses[].feed" in _advice("arm", status, load(on_feed(arm).write()))
