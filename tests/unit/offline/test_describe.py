"""What the daemon would do, in words."""

import re
from pathlib import Path

from fsw.__main__ import main
from fsw.checks.configuration import validate
from fsw.config import load
from offline.describe import describe
from tests.support.check_cases import assert_named
from tests.support.driver_configs import unit_on_bus


def test_the_description_says_what_the_daemon_would_do(arm):
    config = load(arm.write())
    text = describe(config, validate(config)[0])
    assert_named(
        text,
        "3 joints",
        "root link 200 kg, all links 209 kg",
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


def test_all_links_include_the_root_link(arm):
    totals = []
    for kg in ("200", "20"):
        arm.urdf = arm.urdf.replace('<mass value="200"/>', f'<mass value="{kg}"/>')
        config = load(arm.write())
        text = describe(config, validate(config)[0])
        totals += [line.strip() for line in text.splitlines() if "all links" in line]
    assert totals == ["root link 200 kg, all links 209 kg", "root link 20 kg, all links 29 kg"]


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
        text,
        "taken as exact: geometry of the arm, links, base, zeros of joints, scales of the joints' "
        "angles, place of",
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


def test_the_word_that_the_howto_waits_for_is_printed(arm, capsys):
    page = Path(__file__).parents[3] / "docs" / "howto" / "robot.md"
    (word,) = re.findall(r"until it says `(\w+)`", page.read_text(encoding="utf-8"))
    assert main(["check", str(arm.write())]) == 0
    assert f": {word}, " in capsys.readouterr().out.splitlines()[-1]


def test_a_bus_of_samples_sends_no_sync(arm):
    arm.data["buses"] = [{"name": "arm", "interface": "samples", "rate_hz": 250.0}]
    for joint in arm.data["joints"]:
        joint["driver"] = "samples"
        joint.pop("node_id")
    config = load(arm.write())
    (line,) = [x for x in describe(config, validate(config)[0]).splitlines() if "buses  " in x]
    assert line.split(maxsplit=1)[1] == (
        "arm: samples of a recording, 250 Hz; joints axis1, axis2, axis3"
    )


def test_tailored_nodes_are_listed_beside_a_described_unit(arm):
    unit_on_bus(arm.data)
    config = load(arm.write())
    assert_named(describe(config, validate(config)[0]), "rate_x unit.rate_x (0x300)", "nodes 0x")
