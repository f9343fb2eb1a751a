"""Wheels and thrusters: described, rehearsed, and one line for every fault."""

import pytest
from jsonschema import Draft202012Validator

from fsw.checks.configuration import validate
from fsw.config import load
from fsw.config.reference import json_schema
from fsw.errors import ConfigError
from offline.describe import describe
from tests.support.check_cases import assert_named
from tests.support.driver_configs import unit_on_bus


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
        ({"axis_B": [1.0, 1.0, 0.0]}, ("wheels.0.axis_B: [1.0, 1.0, 0.0] has length 1.414; must",)),
        ({"axis_B": [1.0, 0.0]}, ("wheels.0.axis_B: entry 3 is missing (value: [1.0, 0.0])",)),
        ({"axis_B": None}, ("wheels.0.axis_B: must be a list (value: null)",)),
        ({"node_id": None}, ("wheels.0.bus: 'arm' without node_id", "has both")),
        ({"rate_hz": 0.5}, ("wheels.0.rate_hz: 0.5 must be at least 1",)),
        ({"speed_noise_rad_s": 600.0}, ("wheels.0.speed_noise_rad_s: 600 must be below", "600")),
        ({"torque_noise_nm": 0.5}, ("wheels.0.torque_noise_nm: 0.5 must be below", "limit_nm 0.4")),
    ],
)
def test_a_wrong_wheel_is_one_line(arm, changes, words):
    arm.data["wheels"] = [wheel(**changes)]
    with pytest.raises(ConfigError) as caught:
        load(arm.write())
    assert len(str(caught.value).splitlines()) == 1
    assert_named(str(caught.value), *words)


@pytest.mark.parametrize("section", ["wheels", "thrusters", "modes", "estimator", "recorder"])
def test_a_section_that_is_null_is_left_out(arm, section):
    arm.data.pop(section, None)
    values = load(arm.write()).model_dump()
    arm.data[section] = None
    assert load(arm.write()).model_dump() == values
    assert Draft202012Validator(json_schema()).is_valid(arm.data)


def test_a_section_that_is_required_may_not_be_null(arm):
    arm.data["robot"] = None
    assert not Draft202012Validator(json_schema()).is_valid(arm.data)
    with pytest.raises(ConfigError, match="robot: must be a section of keys and values"):
        load(arm.write())


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
        ({"direction_B": [1.0, 1.0, 0.0]}, {}, ("thrusters.0.direction_B: [1.0, 1.0, 0.0] has",)),
        ({"valve": 16}, {}, ("thrusters.0.valve: must be at most 15 (value: 16)",)),
        (
            {},
            {"method": "rda", "outside_wrench": "watch"},
            ("'watch' needs method fused", "method rda"),
        ),
    ],
)
def test_a_wrong_thruster_is_one_line(arm, changes, estimator, words):
    arm.data["thrusters"], arm.data["estimator"] = [thruster(**changes)], estimator
    with pytest.raises(ConfigError) as caught:
        load(arm.write())
    assert len(str(caught.value).splitlines()) == 1
    assert_named(str(caught.value), *words)


@pytest.mark.parametrize(
    ("wheels", "thrusters", "words"),
    [
        ([{}, {"node_id": 0x21}], [{}], "wheels.node_id: 'arm:0x21' is used 2 times"),
        ([{}], [{"node_id": 0x21}], "thrusters.node_id: 'arm:0x21' is used 2 times"),
        ([], [{}, {"valve": 0}], "thrusters.valve: 'arm:0x31 valve 0' is used 2 times"),
        ([], [{}, {"rate_hz": 25.0}], "thrusters.1.rate_hz: 25 must be 50, as of the other"),
    ],
)
def test_a_node_or_valve_of_two_devices_is_named_by_its_own_key(arm, wheels, thrusters, words):
    arm.data["wheels"] = [wheel(k, **changes) for k, changes in enumerate(wheels)]
    arm.data["thrusters"] = [thruster(k, **changes) for k, changes in enumerate(thrusters)]
    with pytest.raises(ConfigError) as caught:
        load(arm.write())
    assert_named(str(caught.value), words)


def test_a_described_node_is_no_tailored_one(arm):
    arm.data["wheels"] = [wheel()]
    unit_on_bus(arm.data)
    load(arm.write())
    arm.data["imu"] |= {"description": "unit.eds", "node_id": 0x21}
    with pytest.raises(ConfigError, match=r"wheels\.node_id: 'arm:0x21' is used 2 times"):
        load(arm.write())


def test_liquid_as_heavy_as_its_body_is_one_line(arm):
    part = {"mass_kg": 39.9, "place_m": [0.0, 0.0, 0.0]}
    arm.data["bodies"]["target"]["liquid"] = [part, part]
    load(arm.write())
    part["mass_kg"] = 40.0
    with pytest.raises(ConfigError, match=r"target\.liquid: 80 kg in all must be below mass_kg 80"):
        load(arm.write())
