"""Checks: one spoiled configuration per rule, and what the daemon would do in words."""

import os
import re

import pytest

from fsw.checks.configuration import missing_devices, validate, validate_outputs
from fsw.commands.describe import describe
from fsw.config import load
from fsw.messages.errors import ConfigError
from tests.conftest import arm_config


def fault(arm, check=validate):
    config = load(arm.write())
    with pytest.raises(ConfigError) as caught:
        check(config)
    message = str(caught.value)
    assert all(line.startswith(config.name + ": ") for line in message.splitlines()), message
    return message


def assert_named(message, *words):
    assert [word for word in words if word not in message] == [], message


def test_a_correct_configuration_has_no_warning(arm):
    problem, warnings = validate(load(arm.write()))
    assert problem.model.n == 3
    assert warnings == []


# robot


def test_a_missing_robot_file_is_named(arm):
    arm.data["robot"]["urdf"] = "none.urdf"
    assert_named(fault(arm), "robot.urdf", str(arm.folder / "none.urdf"), "No such file")


@pytest.mark.parametrize("text", ["", "links: 3", "<robot><link/>", "<sdf/>"])
def test_a_robot_file_that_is_no_urdf_is_one_line(arm, text, capfd):
    arm.urdf = text
    message = fault(arm)
    assert_named(message, "robot.urdf", "is no URDF")
    assert len(message.splitlines()) == 1
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("kind", ["continuous", "planar"])
def test_a_joint_of_a_kind_that_is_not_known_is_named(arm, kind):
    arm.robot(3, kind)
    assert_named(fault(arm), "robot.urdf", "'axis1'", kind, "revolute, prismatic or fixed")


def test_a_joint_of_another_kind_than_the_urdf_s_is_named(arm):
    arm.robot(3, "prismatic")
    assert_named(fault(arm), "joints.0.kind", "'revolute'", "'axis1' is prismatic")


def test_a_revolute_joint_without_limit_is_named(arm, capfd):
    arm.urdf = re.sub(r"<limit[^>]*>", "", arm.urdf, count=1)
    assert_named(fault(arm), "robot.urdf", "'axis1'", "no <limit>", "effort")
    assert capfd.readouterr().err == ""


BAD_URDF = [
    ('parent link="link2"', 'parent link="nolink"', "nolink"),
    ('mass value="3"', 'mass value="three"', "three"),
    ("</robot>", '<link name="alone"/></robot>', "alone"),
    ('link name="link2"', 'link name="link1"', "link1"),
    ('joint name="axis2"', 'joint name="axis1"', "axis1"),
    ('velocity="0.5"', "", "velocity"),
    ('axis xyz="0 0 1"', 'axis xyz="0 0 0"', "0 0 0"),
    ('axis xyz="0 0 1"', 'axis xyz="z"', "three numbers"),
]


@pytest.mark.parametrize(("good", "bad", "word"), BAD_URDF, ids=[bad for _, bad, _ in BAD_URDF])
def test_what_the_urdf_library_only_prints_is_one_line_here(arm, capfd, good, bad, word):
    arm.urdf = arm.urdf.replace(good, bad, 1)
    message = fault(arm)
    assert_named(message, "robot.urdf", word)
    assert len(message.splitlines()) == 1
    assert capfd.readouterr().err == ""


def test_more_joints_than_the_robot_has_are_listed_on_both_sides(arm):
    arm.robot(2)
    assert_named(fault(arm), "joints", "['axis1', 'axis2', 'axis3']", "2 joints of the robot")


def test_fewer_joints_than_the_robot_has_are_listed_on_both_sides(arm):
    arm.robot(4)
    assert_named(
        fault(arm), "joints", "['axis1', 'axis2', 'axis3']", "4 joints of the robot", "axis4"
    )


def test_a_misspelt_joint_is_listed_on_both_sides(arm):
    arm.data["joints"][1]["name"] = "axis_2"
    assert_named(fault(arm), "joints", "axis_2", "'axis2'")


def test_joints_in_another_order_than_the_robots_are_accepted(arm):
    arm.data["joints"].reverse()
    problem, _ = validate(load(arm.write()))
    assert problem.model.joint_names == ("axis1", "axis2", "axis3")


def test_a_missing_tool_frame_lists_the_frames(arm):
    arm.data["robot"]["tool_frame"] = "hand"
    assert_named(fault(arm), "robot.tool_frame", "'hand'", "gripper", "link3")


def test_a_tool_frame_inside_the_arm_is_refused(arm):
    arm.data["robot"]["tool_frame"] = "link1"
    assert_named(fault(arm), "robot.tool_frame", "'link1'", "last link")


def test_a_massless_root_link_needs_the_base_given(arm):
    arm.urdf = re.sub(r"<inertial>.*?</inertial>", "", arm.urdf, count=1)
    assert_named(fault(arm), "robot.urdf", "root link", "mass 0 kg", "positive, or bodies.base")


def test_a_massless_root_link_serves_when_the_base_is_given(arm):
    arm.urdf = re.sub(r"<inertial>.*?</inertial>", "", arm.urdf, count=1)
    arm.data["bodies"]["base"] = {
        "mass_kg": 200.0,
        "com_m": [0.1, 0.0, -0.3],
        "inertia_kg_m2": [60.0, 0.0, 0.0, 50.0, 0.0, 40.0],
    }
    assert validate(load(arm.write()))[1] == []


def test_a_negative_link_mass_is_refused(arm):
    arm.urdf = arm.urdf.replace('<mass value="3"/>', '<mass value="-3"/>', 1)
    assert_named(fault(arm), "robot.urdf", "'axis1'", "-3 kg", "at least 0")


def test_an_inertia_no_body_can_have_is_a_warning(arm):
    arm.urdf = arm.urdf.replace('izz="0.01"', 'izz="0.1"', 1)
    _, warnings = validate(load(arm.write()))
    assert len(warnings) == 1
    assert_named(warnings[0], "robot.urdf", "'axis1'", "sum of the other two")


def test_a_robot_without_joints_is_refused(arm):
    arm.robot(0)
    assert_named(fault(arm), "robot.urdf", "0 joints that move", "reaction wheels")


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


def test_the_description_says_what_the_daemon_would_do(arm):
    config = load(arm.write())
    text = describe(config, validate(config)[0])
    assert_named(
        text,
        "3 joints",
        "root link 200 kg, all links 9 kg",
        "target: unknown; prior mass 80 +- 40 kg",
        "base: known; as the URDF's root link",
        "0x11 axis1, 0x12 axis2, 0x13 axis3",
        "/can/arm",
        "/serial/imu",
        "/serial/star_tracker",
        "closed 150 ms after their end (slowest: star_tracker, 117.3 ms)",
        "torque_offset.axis1 0 +- 0.1",
        "effects that are off: Coulomb friction (joints[].friction_coulomb_sigma_nm)",
        str(arm.folder / "recordings"),
    )


def test_an_effect_that_only_some_joints_have_is_off_at_the_others(arm):
    arm.data["joints"][1]["friction_coulomb_sigma_nm"] = 0.3
    arm.data["joints"][0]["link_sigma_ratio"] = 0.0
    config = load(arm.write())
    assert_named(
        describe(config, validate(config)[0]),
        "Coulomb friction at axis1, axis3 (joints[].friction_coulomb_sigma_nm)",
        "viscous friction (joints[]",
        "taken as exact: geometry of the arm, links of axis1",
    )


def test_what_a_regression_takes_as_exact_is_said_so(arm):
    arm.data["estimator"] = {"method": "mrnea", "weighting": "ols"}
    config = load(arm.write())
    text = describe(config, validate(config)[0])
    assert_named(
        text, "taken as exact: geometry of the arm, links, base, zeros of joints, place of"
    )
    assert "known bodies" not in text


def test_a_clamped_robot_is_not_told_of_what_it_cannot_have(arm):
    for key in ("imu", "star_tracker", "estimator"):
        arm.data.pop(key, None)
    arm.data["base"] = {"motion": "clamped", "gravity_B_m_s2": [0.0, 0.0, -9.81]}
    config = load(arm.write())
    text = describe(config, validate(config)[0])
    off = text.partition("effects that are off: ")[2].partition("\n")[0]
    assert "Coulomb friction" in off
    for word in ("gyro", "momentum", "wheels", "thrusters", "gradient", "wrench on the base"):
        assert word not in off
    assert "inertial unit" not in text.partition("taken as exact: ")[2].partition("\n")[0]


def wheel(k=0, **changes):
    return {
        "name": f"wheel{k + 1}",
        "bus": "arm",
        "node_id": 0x21 + k,
        "rate_hz": 50.0,
        "axis_B": [0.0, 0.6, 0.8],
        "inertia_kg_m2": 0.02,
        "speed_limit_rad_s": 600.0,
        "speed_noise_rad_s": 0.01,
        "torque_limit_nm": 0.4,
    } | changes


@pytest.mark.parametrize("rate_hz", [1.0, 50.0])
def test_wheels_are_described_and_pass_the_dry_update(arm, rate_hz):
    arm.data["wheels"] = [wheel(k, rate_hz=rate_hz) for k in range(2)]
    arm.data["estimator"] = {"momentum_sigma_nms": 5.0}
    config = load(arm.write())
    problem, warnings = validate(config)
    assert warnings == []
    assert_named(
        describe(config, problem),
        f"wheel1: axis [0 0.6 0.8], 0.02 kg m^2 +- 1.0%, speed at {rate_hz:g} Hz, at most 12 N m s",
        "mass and locked inertia of every wheel belong to base; imbalance is noise",
        "0x21 wheel1, 0x22 wheel2",
        "inertia of wheels 0.01",
    )


def test_a_robot_without_wheels_is_told_that_they_are_off(arm):
    config = load(arm.write())
    assert_named(describe(config, validate(config)[0]), "reaction wheels (wheels)")


def test_wheels_with_no_momentum_to_hold_are_warned_of(arm):
    arm.data["wheels"] = [wheel()]
    _, warnings = validate(load(arm.write()))
    assert_named(warnings[0], "estimator.momentum_sigma_nms: 0 with wheels")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"bus": "other"}, ("wheels.0.bus: 'other'", "'arm'")),
        ({"rate_hz": 1e4}, ("wheels.0.rate_hz: 10000 must be at most",)),
        ({"node_id": 0x11}, ("wheels.node_id: 'arm:0x11' is used 2 times",)),
        ({"axis_B": [1.0, 1.0, 0.0]}, ("axis_B", "must have length 1")),
    ],
)
def test_a_wrong_wheel_is_one_line(arm, changes, words):
    arm.data["wheels"] = [wheel(**changes)]
    with pytest.raises(ConfigError) as caught:
        load(arm.write())
    assert len(str(caught.value).splitlines()) == 1
    assert_named(str(caught.value), *words)


def thruster(k=0, **changes):
    return {
        "name": f"thruster{k + 1}",
        "bus": "arm",
        "node_id": 0x31,
        "valve": k,
        "rate_hz": 50.0,
        "p_B_m": [0.0, 1.0, 0.5],
        "direction_B": [1.0, 0.0, 0.0],
        "force_n": 22.0,
        "delay_sigma_s": 0.001,
    } | changes


def test_thrusters_are_described_and_pass_the_dry_update(arm):
    arm.data["thrusters"] = [thruster(k) for k in range(2)]
    _, warnings = validate(load(arm.write()))
    assert_named(warnings[0], "estimator.momentum_sigma_nms: 0 with thrusters")
    arm.data["estimator"] = {"momentum_sigma_nms": 5.0}
    config = load(arm.write())
    problem, warnings = validate(config)
    assert warnings == []
    text = describe(config, problem)
    assert_named(
        text,
        "thruster1: 22 N +- 3.0% at [0 1 0.5] m along [1 0 0], delay 5 +- 1 ms, rise 10 +- 0 ms",
        "propellant that leaves is not",
        "0x31 thruster",
        "force of thrusters 0.03",
        "(estimator.outside_wrench)",
    )
    arm.data.pop("thrusters")
    arm.data["estimator"] = {"outside_wrench": "watch"}
    config = load(arm.write())
    text = describe(config, validate(config)[0])
    assert_named(text, "thrusters (thrusters)")
    assert "outside_wrench" not in text


@pytest.mark.parametrize(
    ("changes", "estimator", "words"),
    [
        ({"bus": "other"}, {}, ("thrusters.0.bus: 'other'", "'arm'")),
        ({"rate_hz": 1e4}, {}, ("thrusters.0.rate_hz: 10000 must be at most",)),
        ({"node_id": 0x11}, {}, ("thrusters.node_id: 'arm:0x11' is used 2 times",)),
        ({"direction_B": [1.0, 1.0, 0.0]}, {}, ("direction_B", "must have length 1")),
        ({}, {"method": "mrnea", "weighting": "bc"}, ("weighting bc cannot take them",)),
        ({}, {"method": "rda", "outside_wrench": "watch"}, ("'watch' needs method fused",)),
    ],
)
def test_a_wrong_thruster_is_one_line(arm, changes, estimator, words):
    arm.data["thrusters"], arm.data["estimator"] = [thruster(**changes)], estimator
    with pytest.raises(ConfigError) as caught:
        load(arm.write())
    assert len(str(caught.value).splitlines()) == 1
    assert_named(str(caught.value), *words)


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


def test_the_description_says_how_telecommands_are_taken(arm):
    config = load(arm.write())
    assert_named(describe(config, validate(config)[0]), "none, and no telecommands")
    keys = [{"spi": 3, "file": "a"}, {"spi": 4, "credential": "b"}]
    arm.data["telemetry"] = {"host": "::", "tc_security": "sdls", "sdls": {"keys": keys}}
    config = load(arm.write())
    text = describe(config, validate(config)[0])
    assert_named(
        text, "TCP :::10025", "authenticated, SPI 3 command, SPI 4 command", "starts in identify"
    )
