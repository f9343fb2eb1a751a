"""Checks: one spoiled configuration per rule."""

import os

import pytest
from can.interfaces import VALID_INTERFACES

from fsw.checks.configuration import missing_devices, validate
from fsw.checks.interfaces import PHYSICAL, SIMULATED
from fsw.checks.outputs import validate_outputs
from fsw.config import load
from fsw.errors import ConfigError
from tests.conftest import arm_config
from tests.support.check_cases import assert_named, fault


def test_a_correct_configuration_has_no_warning(arm):
    problem, warnings = validate(load(arm.write()))
    assert problem.model.n == 3
    assert warnings == []


def test_a_clamped_arm_without_torques_is_said_to_show_no_body(arm):
    for name in ("imu", "star_tracker"):
        arm.data.pop(name, None)
    arm.data["base"] = {"motion": "clamped", "gravity_B_m_s2": [0.0, 0.0, -9.81]}
    kept = ("name", "bus", "node_id", "speed_limit_rad_s", "position_noise_rad")
    blind = [{key: own[key] for key in kept if key in own} for own in arm.data["joints"]]
    seeing = arm.data["joints"]
    arm.data["joints"] = [own | {"torque": "none"} for own in blind]
    _, warnings = validate(load(arm.write()))
    assert any("joints[].torque: all are none; on a clamped base" in own for own in warnings)
    arm.data["joints"] = [seeing[0], *arm.data["joints"][1:]]
    _, warnings = validate(load(arm.write()))
    assert not any("joints[].torque" in own for own in warnings)


# windows and lag


def test_a_bus_too_slow_for_the_window_is_refused(arm):
    arm.data["buses"][0]["rate_hz"] = 10.0
    assert_named(fault(arm), "buses.0.rate_hz", "10 ", "4.0 samples", "at least 8")


def test_a_window_too_short_for_the_polynomial_is_refused(arm):
    arm.data["buses"][0]["rate_hz"] = 50.0
    arm.data["estimator"] = {"window_s": 0.4, "nodes": 4, "min_fill_ratio": 0.6}
    assert_named(fault(arm), "buses.0.rate_hz", "50 ", "20.0 samples", "at least 14", "nodes 4")


def test_an_imu_too_slow_for_the_window_is_refused(arm):
    arm.data["imu"]["rate_hz"] = 125.0
    arm.data["estimator"] = {"window_s": 0.06}
    assert_named(fault(arm), "imu.rate_hz", "125 ", "7.5 samples", "at least 8")


def test_a_window_of_more_samples_than_memory_is_for_is_one_line(arm):
    arm.data["estimator"] = {"window_s": 300.0}
    message = fault(arm)
    assert_named(
        message, "estimator.window_s: 300 ", "150000 samples", "imu.rate_hz 500", "most 40"
    )
    assert len(message.splitlines()) == 1


def test_the_longest_window_passes_the_dry_update(arm):
    arm.data["estimator"] = {"window_s": 40.0, "lag_s": 0.15}
    validate(load(arm.write()))


def test_a_lag_shorter_than_the_star_tracker_is_refused(arm):
    arm.data["estimator"] = {"lag_s": 0.1}
    assert_named(fault(arm), "estimator.lag_s", "0.1 ", "star_tracker", "at least 0.117")


def test_a_lag_shorter_than_the_imu_is_refused(arm):
    del arm.data["star_tracker"]
    arm.data["estimator"] = {"lag_s": 0.008}
    message = fault(arm)
    assert_named(message, "estimator.lag_s", "0.008 ", "imu", "at least 0.011")


def test_a_lag_shorter_than_the_joints_is_refused(arm):
    arm.data["estimator"] = {"lag_s": 0.005}
    assert_named(fault(arm), "estimator.lag_s", "0.005 ", "buses.0", "at least 0.026")


# links


def test_an_overloaded_bus_is_refused(arm):
    arm.data["buses"][0].update(rate_hz=500.0, bitrate=250_000)
    message = fault(arm)
    assert_named(message, "buses.0.rate_hz", "500 ", "bitrate 250000", "at most 100%")


def test_a_socketcan_bus_without_bit_rate_is_taken_for_one_megabit(arm):
    arm.data["scheduler"]["tick_rate_hz"] = 2000.0
    arm.data["buses"][0].update(rate_hz=2000.0, bitrate=None, interface="socketcan")
    assert_named(fault(arm), "buses.0.rate_hz", "assumed 1000000 bit/s", "at most 100%")


def test_a_simulated_bus_without_bit_rate_is_only_warned_of(arm):
    arm.data["scheduler"]["tick_rate_hz"] = 2000.0
    arm.data["buses"][0].update(rate_hz=2000.0, bitrate=None, interface="udp_multicast")
    _, warnings = validate(load(arm.write()))
    assert_named(warnings[0], "buses.0.rate_hz", "2000 ", "70%")


def test_a_highly_loaded_bus_is_warned_of(arm):
    arm.data["buses"][0].update(rate_hz=250.0, bitrate=170_000)
    _, warnings = validate(load(arm.write()))
    assert_named(warnings[0], "buses.0.rate_hz", "250 ", "70%")


def test_a_bus_without_joints_is_warned_of(arm):
    arm.data["buses"].append({**arm.data["buses"][0], "name": "spare", "channel": "spare"})
    _, warnings = validate(load(arm.write()))
    assert_named(warnings[0], "buses.1.name", "no joint", "'spare'")


@pytest.mark.parametrize(
    ("key", "value", "step"),
    [("torque_noise_nm", 1e-3, "0.0029"), ("position_noise_rad", 1e-8, "1.1e-07")],
)
def test_a_noise_below_the_rounding_of_the_wire_is_warned_of(arm, key, value, step):
    arm.data["joints"][1][key] = value
    _, warnings = validate(load(arm.write()))
    assert_named(warnings[0], f"joints.1.{key}", f"{value:g}", step)


def test_a_data_bit_rate_below_the_bit_rate_is_refused(arm):
    arm.data["buses"][0].update(fd=True, bitrate=1_000_000, data_bitrate=500_000)
    assert_named(fault(arm), "buses.0.data_bitrate", "500000", "at least bitrate 1000000")


def test_a_latch_offset_of_a_whole_period_is_refused(arm):
    arm.data["buses"][0]["latch_offset_s"] = 0.004
    assert_named(fault(arm), "buses.0.latch_offset_s", "0.004", "SYNC period, 0.004")


def test_an_imu_rate_the_unit_does_not_have_is_refused(arm):
    arm.data["imu"]["rate_hz"] = 400.0
    assert_named(fault(arm), "imu.rate_hz", "400", "125, 250, 500, 1000, 2000")


def test_a_rate_that_the_wire_saturates_at_is_refused(arm):
    arm.data["imu"]["max_rate_rad_s"] = 8.94
    assert_named(fault(arm), "imu.max_rate_rad_s", "8.94", "below 8.936", "saturated")
    arm.data["imu"]["max_rate_rad_s"] = 8.93
    assert validate(load(arm.write()))[1] == []


def test_momentum_without_a_star_tracker_is_warned_of(arm):
    arm.data["estimator"] = {"momentum_sigma_nms": 50.0}
    arm.data.pop("star_tracker", None)
    _, warnings = validate(load(arm.write()))
    assert_named(warnings[0], "estimator.momentum_sigma_nms: 50 without star_tracker")


def test_a_line_too_slow_for_the_imu_is_refused(arm):
    arm.data["imu"].update(rate_hz=2000.0, baud_rate=460800)
    assert_named(fault(arm), "imu.baud_rate", "460800", "at least 560000")


def test_a_line_too_slow_for_the_longest_datagram_is_warned_of(arm):
    arm.data["imu"].update(rate_hz=2000.0, baud_rate=921600)
    _, warnings = validate(load(arm.write()))
    assert_named(warnings[0], "imu.baud_rate", "921600", "longest datagram")


@pytest.mark.parametrize("key", ["gyro_group_delay_s", "acc_group_delay_s"])
def test_a_group_delay_in_milliseconds_is_refused(arm, key):
    arm.data["imu"][key] = 2.2
    arm.data["estimator"] = {"lag_s": 10.0}
    assert_named(fault(arm), f"imu.{key}", "2.2", "at most 0.1")


def test_a_line_too_slow_for_the_star_tracker_is_refused(arm):
    arm.data["star_tracker"].update(baud_rate=4800, rate_hz=10.0)
    assert_named(fault(arm), "star_tracker.baud_rate", "4800", "at least 17600")


def test_two_names_of_one_serial_device_are_refused(arm):
    (arm.folder / "tty").touch()
    (arm.folder / "by-id").symlink_to("tty")
    arm.data["imu"]["port"] = str(arm.folder / "tty")
    arm.data["star_tracker"]["port"] = str(arm.folder / "by-id")
    assert_named(fault(arm), "star_tracker.port", "by-id", "imu.port", "one device only")


def test_every_fault_is_told_at_once(arm):
    arm.data["imu"]["rate_hz"] = 400.0
    arm.data["robot"]["tool_frame"] = "hand"
    assert_named(fault(arm), "imu.rate_hz", "robot.tool_frame")


# files and devices


@pytest.mark.parametrize(
    ("key", "section", "name"),
    [
        ("recorder.directory", "recorder", "directory"),
        ("service.state_directory", "service", "state_directory"),
    ],
)
def test_a_folder_that_cannot_be_is_refused(arm, key, section, name):
    (arm.folder / "file").touch()
    arm.data[section][name] = "file/below"
    message = fault(arm, validate_outputs)
    assert_named(message, key, str(arm.folder / "file" / "below"), "not a directory")


def test_a_state_folder_too_long_for_a_socket_is_refused(arm):
    arm.data["service"]["state_directory"] = "/tmp/" + "s" * 100
    assert_named(fault(arm, validate_outputs), "service.state_directory", "105 bytes", "at most 87")


def test_folders_that_do_not_exist_yet_are_accepted_and_not_made(arm):
    arm.data["service"]["state_directory"] = "/tmp/fsw-state-of-a-test"
    arm.data["recorder"]["directory"] = "deep/below"
    validate_outputs(load(arm.write()))
    assert not (arm.folder / "deep").exists()


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("recorder", "part_s", 1e-6),
        ("recorder", "chunk_bytes", 10**12),
        ("service", "status_rate_hz", 1e5),
        ("service", "disk_reserve_bytes", 0),
        ("service", "disk_reserve_bytes", 10**15),
        ("scheduler", "tick_rate_hz", 1e5),
        ("imu", "rate_hz", 1e5),
        ("star_tracker", "rate_hz", 1e5),
        ("telemetry", "science_rate_hz", 1e5),
        ("telemetry", "queue_bytes", 10**8),
        ("telemetry", "packet_stores", {"science_bytes": 1 << 36}),
    ],
)
def test_what_no_machine_bears_is_refused_with_its_bound(arm, section, key, value):
    arm.data.setdefault(section, {})[key] = value
    with pytest.raises(ConfigError) as error:
        load(arm.write())
    assert_named(str(error.value), f"{section}.{key}", "must be")
    assert len(str(error.value).splitlines()) == 1


def test_the_reserve_holds_the_last_chunks(arm):
    arm.data["recorder"]["chunk_bytes"] = 1 << 24
    with pytest.raises(ConfigError, match="disk_reserve_bytes: 4194304 must be at least 67108864"):
        load(arm.write())


KEYS = [{"spi": 1, "file": "keys/command.key"}]


@pytest.mark.parametrize(
    ("recordings", "state", "held"),
    [
        (".", "state", "the configuration"),
        ("keys", "state", "telemetry.sdls.keys.0.file"),
        ("state", "state", "service.state_directory"),
        ("below", "below/state", "service.state_directory"),
        ("link", "state", "service.state_directory"),
        ("state/files", "state", "state/files"),
        ("state/tables/sub", "state", "state/tables"),
        ("..", "state", "robot.urdf"),
    ],
)
def test_recordings_share_their_folder_with_nothing_of_the_daemon(arm, recordings, state, held):
    (arm.folder / "link").symlink_to(arm.folder / "state")
    arm.data["telemetry"] = {"tc_security": "sdls", "sdls": {"keys": KEYS}}
    arm.data["recorder"]["directory"] = recordings
    arm.data["service"]["state_directory"] = state
    assert_named(fault(arm, validate_outputs), "recorder.directory", recordings, held)


@pytest.mark.parametrize("recordings", ["recordings", "state/recordings", "state_recordings"])
def test_recordings_may_lie_beside_everything_else(arm, recordings):
    arm.data["recorder"]["directory"] = recordings
    validate_outputs(load(arm.write()))


def test_devices_not_there_are_listed(arm):
    assert len(missing_devices(load(arm.write()))) == 2
    del arm.data["star_tracker"]
    assert_named(missing_devices(load(arm.write()))[0], "imu.port", "/dev/serial/imu")


def test_a_link_that_is_not_there_and_a_port_without_permission_are_listed(arm, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may use every port
    del arm.data["star_tracker"]
    arm.data["imu"]["port"] = "/dev/null"
    arm.data["buses"][0] |= {"interface": "socketcan", "channel": "can77"}
    port, link = missing_devices(load(arm.write()))
    assert_named(port, "imu.port", "/dev/null", "may not be read and written")
    assert_named(link, "buses.0.channel", "can77", "no interface")


@pytest.mark.parametrize("method", ["fused", "rda", "cm"])
def test_a_weighting_that_does_nothing_is_warned_of(arm, method):
    arm.data["estimator"] = {"method": method, "weighting": "ols"}
    _, warnings = validate(load(arm.write()))
    assert_named(warnings[0], "estimator.weighting", "'ols'", "'eiv'")
    assert method in warnings[0]
    arm.data["estimator"] = {"method": "mrnea", "weighting": "ols"}
    assert validate(load(arm.write()))[1] == []


# telemetry


def test_joints_and_buses_that_telemetry_has_no_room_for_are_warned_of(arm):
    arm.data = arm_config(9)
    arm.robot(9)
    first = arm.data["buses"][0]
    others = [{**first, "name": f"bus{k}", "channel": f"bus{k}"} for k in range(4)]
    arm.data["buses"] += others
    for joint, bus in zip(arm.data["joints"], others, strict=False):
        joint["bus"] = bus["name"]
    assert validate(load(arm.write()))[1] == []
    arm.data["telemetry"] = {}
    joints, buses = validate(load(arm.write()))[1]
    assert_named(joints, "joints: 9", "room for 8", "'axis9'")
    assert "'axis8'" not in joints
    assert_named(buses, "buses: 5", "room for 4", "'bus3'")


def test_a_science_rate_the_loop_does_not_have_is_warned_of(arm):
    arm.data["telemetry"] = {"science_rate_hz": 501.0}
    (warning,) = validate(load(arm.write()))[1]
    assert_named(warning, "telemetry.science_rate_hz: 501", "tick_rate_hz 500")


def test_the_interfaces_are_those_of_python_can() -> None:
    assert {*SIMULATED, *PHYSICAL} - {"udp_frames"} == VALID_INTERFACES
