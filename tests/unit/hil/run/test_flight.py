"""The files of a run: no truth of an unknown body on the flight side, conventions translated."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml

from fsw.config import load as load_config
from hil.run.flight import flight_document, joint_names, write_flight, write_yaml
from hil.run.flight_sensors import position_noise_rad, torque_noise_nm
from hil.run.plant_document import plant_document
from hil.world.prior import draw_prior
from hil.world.scenario import load
from hil.world.sensor_config import NodeConfig, SensorConfig
from tests.support.sliding import JOINT, sliding_urdf


def flight_of(name, seed, folder):
    scenario = load(name)
    priors = {b: draw_prior(scenario.truth[b], seed, b) for b in scenario.unknown}
    document = flight_document(
        scenario, priors, joint_names(scenario), folder, scenario.bus_ports, {}
    )
    return scenario, priors, write_flight(folder, scenario, priors, document)


@pytest.mark.parametrize("name", ["target_leo", "target_leo_1khz", "target_geo", "base", "both"])
def test_every_scenario_makes_a_valid_configuration(name, tmp_path):
    scenario, priors, path = flight_of(name, 3, tmp_path)
    config = load_config(path)
    assert config.unknown == scenario.unknown
    for body, prior in priors.items():
        assert config.bodies[body].mass_kg == prior.report[0]
        assert config.bodies[body].sigma.mass_kg == prior.sigma[0]


def test_the_scenario_at_1_khz_differs_by_rate_and_format_alone(tmp_path):
    def described(name):
        folder = tmp_path / name
        folder.mkdir()
        config = load_config(flight_of(name, 0, folder)[2])
        (bus,) = config.buses
        rates = (bus.rate_hz, config.imu.rate_hz, config.scheduler.tick_rate_hz)
        return rates, bus.fd, {joint.format for joint in config.joints}

    assert described("target_leo") == ((500.0, 500.0, 500.0), False, {"classic"})
    assert described("target_leo_1khz") == ((1000.0, 1000.0, 1000.0), True, {"fd"})
    plain, fast = load("target_leo").sensors, load("target_leo_1khz").sensors
    for node in fast["joints"]["nodes"]:
        assert node.pop("format") == "fd"
    assert fast["imu"].pop("rate_hz") == 2 * plain["imu"].pop("rate_hz") == 1000
    assert fast == plain


@pytest.mark.parametrize("name", ["target_leo", "base", "both"])
def test_no_true_value_of_an_unknown_body_is_in_the_flight_files(name, tmp_path):
    scenario, _, path = flight_of(name, 3, tmp_path)
    written = yaml.safe_load(path.read_text())
    robot = (tmp_path / "robot.urdf").read_text()
    for body in scenario.unknown:
        told = written["bodies"][body]
        values = np.array([told["mass_kg"], *told["com_m"], *told["inertia_kg_m2"]])
        assert not np.any(np.isclose(values, scenario.truth[body], rtol=1e-3))
    if "base" in scenario.unknown:
        assert 'value="1000' not in robot
        assert "0.855" not in robot
        assert "937.5" not in robot


def test_a_known_body_is_given_as_it_is(tmp_path):
    scenario, _, path = flight_of("target_leo", 0, tmp_path)
    base = load_config(path).bodies["base"]
    assert base.sigma is None
    assert base.mass_kg == scenario.truth["base"][0]


def test_the_joint_offset_is_translated(tmp_path):
    scenario, _, path = flight_of("target_leo", 0, tmp_path)
    nodes = SensorConfig.from_dict(scenario.sensors).joints.nodes
    for joint, node in zip(load_config(path).joints, nodes, strict=True):
        q = 0.7
        reading = node.sign * (q - node.zero_offset_rad)
        assert joint.sign * reading - joint.zero_offset_rad == pytest.approx(q)


def test_rounding_on_the_wire_is_part_of_the_noise():
    joints = SensorConfig.from_dict(load("target_leo").sensors).joints
    classic = torque_noise_nm(joints, NodeConfig(node_id=0x11), 500.0)
    assert classic == pytest.approx(math.sqrt(0.05**2 + 0.01**2 / 12))
    step = 2 * math.pi / 2**24
    assert position_noise_rad(joints) == pytest.approx(step * math.sqrt(2 / 12))


def test_overrides_reach_the_estimator(tmp_path):
    scenario = load("target_leo")
    priors = {"target": draw_prior(scenario.truth["target"], 0, "target")}
    document = flight_document(
        scenario, priors, joint_names(scenario), tmp_path, scenario.bus_ports, {"weighting": "ols"}
    )
    path = write_flight(tmp_path, scenario, priors, document)
    assert load_config(path).estimator.weighting == "ols"


def test_the_plant_file_is_accepted_by_the_plant(tmp_path):
    from hil.devices.plant_file import load as load_plant

    path = write_yaml(
        tmp_path / "plant.yaml", plant_document(load("both"), 5, tmp_path, {"arm": 43113})
    )
    file = load_plant(path)
    assert file.seed == 5
    assert (tmp_path / file.trajectory).is_file()
    assert file.bodies.target is not None


def test_angles_in_the_place_of_a_quaternion_are_the_same_for_both_sides(tmp_path):
    """Roll -pi/2 alone is the quaternion (-1, 0, 0, 1) / sqrt(2)."""
    from hil.devices.plant_file import load as load_plant

    scenario = load("target_leo")
    imu = {key: value for key, value in scenario.sensors["imu"].items() if key != "q_BS_xyzw"}
    sensors = scenario.sensors | {"imu": imu | {"rpy_BS_rad": [-math.pi / 2, 0, 0]}}
    turned = replace(scenario, sensors=sensors)
    document = plant_document(turned, 1, tmp_path, {"arm": 43113})
    plant = load_plant(write_yaml(tmp_path / "plant.yaml", document))
    half = math.sqrt(0.5)
    assert plant.sensors.imu.q_BS_xyzw == pytest.approx((-half, 0, 0, half))
    told = flight_document(turned, {}, joint_names(turned), tmp_path, turned.bus_ports, {})
    assert told["imu"]["mounting"]["q_BS_xyzw"] == pytest.approx([-half, 0, 0, half])


def test_a_fault_of_the_plant_file_is_one_line(tmp_path):
    from hil.devices.plant_file import load as load_plant

    document = plant_document(load("both"), 5, tmp_path, {"arm": 43113}) | {"seed": "x"}
    with pytest.raises(ValueError, match=r"^seed: must be a whole number \(value: \"x\"\)$"):
        load_plant(write_yaml(tmp_path / "plant.yaml", document))


def test_the_urdf_says_which_joint_is_prismatic(tmp_path):
    scenario = replace(load("target_leo"), urdf=sliding_urdf(tmp_path))
    told = flight_document(scenario, {}, joint_names(scenario), tmp_path, scenario.bus_ports, {})
    kinds = [joint.get("kind", "revolute") for joint in told["joints"]]
    assert [k for k, kind in enumerate(kinds) if kind == "prismatic"] == [JOINT]


def test_an_uncertain_stamp_adds_to_the_position_noise():
    joints = SensorConfig.from_dict(load("target_leo").sensors).joints
    plain = position_noise_rad(joints)
    assert position_noise_rad(joints, 1e-6) == pytest.approx(math.hypot(plain, 1e-6))


def test_the_wheels_reach_the_plant_as_they_are_and_the_flight_side_off_by_their_sigma(tmp_path):
    from hil.devices.plant_file import load as load_plant

    scenario = load("wheels_leo")
    path = write_yaml(
        tmp_path / "plant.yaml", plant_document(scenario, 5, tmp_path, {"arm": 43113})
    )
    assert load_plant(path).wheels == scenario.wheels
    names = tuple(f"joint{k + 1}" for k in range(7))
    told = [
        flight_document(scenario, {}, names, tmp_path, {"arm": 43113}, {}, seed=seed)["wheels"]
        for seed in range(200)
    ]
    ratio = np.array([[w["inertia_kg_m2"] for w in own] for own in told])
    off = scenario.wheels.inertias_kg_m2 / ratio - 1.0
    assert np.std(off) == pytest.approx(scenario.wheels.inertia_sigma_ratio, rel=0.1)
    assert [w["node_id"] for w in told[0]] == [0x21, 0x22, 0x23, 0x24]
