"""A configuration of one's own on the bench: devices as it describes them, mismatches in words."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from fsw.config import load as load_config
from fsw.drivers.sources.joint_calibration import Calibration
from hil.__main__ import main
from hil.run.default_doubts import write_with_doubts
from hil.run.own_devices import described
from hil.run.own_flight import own_priors, own_world
from hil.world.links import read_links
from hil.world.scenario import FOLDER, ScenarioError, load, names
from hil.world.sensor_config import SensorConfig

OWN = FOLDER / "configurations"


def changed(folder: Path, change, name: str = "target_leo") -> Path:
    document = yaml.safe_load((OWN / f"{name}.yaml").read_text(encoding="utf-8"))
    document["robot"]["urdf"] = str(load(name).urdf)
    change(document)
    path = folder / "own.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


def without_doubts(document) -> None:
    document["robot"]["links_sigma_ratio"] = 0.0
    for joint in document["joints"]:
        joint |= {"torque_scale_sigma_ratio": 0.0, "zero_sigma_rad": 0.0}
    document["imu"] |= {"mounting_position_sigma_m": 0.0, "mounting_angle_sigma_rad": 0.0}


def held(document) -> None:
    document["bodies"]["panel"] = document["bodies"]["target"] | {"frame": "link3"}
    document["unknown"] = ["panel"]


def test_devices_without_doubts_are_calibrated_by_the_configuration(tmp_path):
    """What a node or a unit sends becomes the truth again; the rules are those of the ICD."""

    def change(document) -> None:
        without_doubts(document)
        document["joints"][1] |= {"node_id": 0x41, "torque_gain": -2.0, "torque_offset_nm": 0.7}
        document["joints"].reverse()
        document["imu"]["mounting"] = {"p_BS_m": [1.0, 2.0, 3.0], "rpy_BS_rad": [0.1, 0.2, 0.3]}
        document["imu"]["gyro_bias_S_rad_s"] = [0.01, 0.0, -0.02]

    path = changed(tmp_path, change)
    scenario, config = own_world(load("target_leo"), path, None, 3, tmp_path / "run")
    sensors = SensorConfig.from_dict(scenario.sensors)
    nodes = {node.node_id: node for node in sensors.joints.nodes}
    assert [node.node_id for node in sensors.joints.nodes][:2] == [0x11, 0x41]
    for joint in config.joints:
        node, q, tau = nodes[joint.node_id], 0.4, 5.0
        raw = node.sign * (q - node.zero_offset_rad)
        raw_nm = node.sign * (node.torque_gain * tau + node.torque_offset_nm)
        found = Calibration([joint]).apply(np.array([0]), np.array([raw]), np.array([raw_nm]))
        np.testing.assert_allclose(np.ravel(found), [q, tau], rtol=1e-12)
    imu = config.imu.mounting
    assert sensors.imu.p_BS_m == imu.p_BS_m
    np.testing.assert_allclose(sensors.imu.q_BS_xyzw, imu.q_BS_xyzw, atol=1e-12)
    assert sensors.imu.gyro_bias_S_rad_s == (0.01, 0.0, -0.02)


def test_doubts_are_drawn_with_their_sigma(tmp_path):
    """50 robots: each drawn error over its sigma has mean 0 and variance 1, within 4 sigma."""
    config = load_config(OWN / "target_leo.yaml")
    world, zeros, gains, masses, places = load("target_leo"), [], [], [], []
    truth = {link.name: link.body.mass_kg for link in read_links(world.urdf) if link.body}
    for seed in range(50):
        scenario = described(world, config, ("target",), seed, tmp_path)
        sensors = SensorConfig.from_dict(scenario.sensors)
        joint, node = config.joints[0], sensors.joints.nodes[0]
        zeros.append(node.zero_offset_rad / joint.zero_sigma_rad)
        gains.append((node.torque_gain - 1.0) / joint.torque_scale_sigma_ratio)
        links = {link.name: link.body for link in read_links(scenario.urdf) if link.body}
        ratio = config.robot.links_sigma_ratio
        masses.append((links["link3"].mass_kg / truth["link3"] - 1.0) / ratio)
        masses.append((scenario.truth["base"][0] / 1000.0 - 1.0) / ratio)
        off = np.subtract(sensors.imu.p_BS_m, config.imu.mounting.p_BS_m)
        places.extend(off / config.imu.mounting_position_sigma_m)
        np.testing.assert_array_equal(scenario.truth["target"], world.truth["target"])
    for values in (zeros, gains, masses, places):
        assert abs(np.mean(values)) < 4.0 / np.sqrt(len(values))
        assert abs(np.var(values) - 1.0) < 4.0 * np.sqrt(2.0 / len(values))


def test_the_devices_may_be_those_of_another_file(tmp_path):
    wrong = changed(tmp_path, lambda d: d["joints"][2].update(sign=-1))
    scenario, config = own_world(
        load("target_leo"), OWN / "target_leo.yaml", wrong, 1, tmp_path / "run"
    )
    assert config.joints[2].sign == 1
    assert SensorConfig.from_dict(scenario.sensors).joints.nodes[2].sign == -1


def test_the_standing_configuration_holds_no_truth_of_an_unknown_body():
    config, world = load_config(OWN / "target_leo.yaml"), load("target_leo")
    assert set(config.unknown) == set(world.unknown)
    for body, prior in own_priors(config).items():
        big = np.abs(world.truth[body]) > 1e-2
        assert np.all(np.abs(prior.report / world.truth[body] - 1.0)[big] > 0.1)


@pytest.mark.parametrize("name", names())
def test_every_scenario_flies_with_the_doubts_that_a_user_has_by_default(name, tmp_path):
    """Links, gains, zeros and mounting of the world differ from what its configuration says."""
    world = load(name)
    path = write_with_doubts(world, 3, tmp_path / "doubts")
    scenario, config = own_world(world, path, None, 3, tmp_path / "run")
    assert config.robot.links_sigma_ratio > 0.0
    with_angle = [joint for joint in config.joints if joint.encoder != "speed"]
    assert all(joint.zero_sigma_rad > 0.0 for joint in with_angle)
    with_torque = [joint for joint in config.joints if joint.torque != "none"]
    assert all(joint.torque_scale_sigma_ratio > 0.0 for joint in with_torque)
    assert set(config.unknown) == set(world.unknown)
    assert len(set(scenario.bus_ports.values())) == len(config.buses)
    true = {link.name: link.body.mass_kg for link in read_links(scenario.urdf) if link.body}
    declared = read_links(config.resolve(config.robot.urdf))
    arm = [link for link in declared[1:] if link.body and link.body.mass_kg > 0.0]
    assert arm
    for link in arm:
        error = abs(true[link.name] / link.body.mass_kg - 1.0)
        assert 0.0 < error < 5.0 * config.robot.links_sigma_ratio
    if config.imu.present:
        place = SensorConfig.from_dict(scenario.sensors).imu.p_BS_m
        off = np.subtract(place, config.imu.mounting.p_BS_m)
        assert 0.0 < np.linalg.norm(off) < 5.0 * np.sqrt(3) * config.imu.mounting_position_sigma_m


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["joints"].pop(), "joints: 6 (joint1, joint2, joint3, joint4, joint5, joint6)"),
        (lambda d: d["robot"].update(urdf=str(load("bench_target").urdf)), "'joint2' otherwise"),
        (lambda d: d["robot"].update(tool_frame="link7"), "robot.tool_frame: 'link7'; must be"),
        (lambda d: d["imu"].update(driver="mip"), "imu.driver: mip; must be stim300"),
        (lambda d: d["star_tracker"].update(driver="samples"), "samples; must be sagitta"),
        (lambda d: d["joints"][3].update(name="j"), "must be the world's 7 (joint1, joint2"),
        (held, "unknown: 'panel'; must be one of the world's base, target"),
        (lambda d: d.update(base={"motion": "planar"}), "base.motion: planar; must be free"),
        (
            lambda d: d["buses"].append(d["buses"][0] | {"name": "leg", "channel": "can1"}),
            "'leg' has",
        ),
    ],
)
def test_a_mismatch_is_one_line_with_exit_2(tmp_path, capsys, change, words):
    path = changed(tmp_path, change)
    arguments = ["run", "target_leo", "--fast", "--config", str(path), "--out", str(tmp_path / "o")]
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert words in error
    assert f"hil: {path}: " in error
    assert "Traceback" not in error


def test_a_device_that_the_world_lacks_is_a_mismatch(tmp_path):
    world = load("target_leo")
    bare = {key: value for key, value in world.sensors.items() if key != "star_tracker"}
    object.__setattr__(world, "sensors", bare)
    with pytest.raises(ScenarioError, match=r"star_tracker: the world has none; leave it out$"):
        own_world(world, OWN / "target_leo.yaml", None, 1, tmp_path)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--devices", "x.yaml"], "--devices: needs --config"),
        (["--devices", "x.yaml", "--doubts"], "--devices: needs --config"),
        (["--truth", "x.npz", "--doubts"], "--truth: not with --config or --doubts"),
        (["--config", "x.yaml"], "x.yaml: cannot be read"),
        (["--config", "x.yaml", "--set", "flight.tick_rate_hz=250"], "--config is given; set it"),
    ],
)
def test_options_that_do_not_go_together(capsys, more, words):
    assert main(["run", "target_leo", "--fast", *more]) == 2
    assert words in capsys.readouterr().err
