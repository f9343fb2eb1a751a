"""NumPy arrays with a URDF: the estimate of a recording of them, and sensors that are the arrays'.

Bounds, set before the first run: arrays and the recording that `fsw import` makes of them give the
same bits and the same findings; the robot that code describes finds the body within 4 sigma of the
truth; a mistake in an array is named, and no text about arrays names a command or a file.
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.spatial.transform import Rotation

import fsw
from fsw.__main__ import main
from fsw.errors import ConfigError, FswError
from hil.run.bench import Setup, prepare
from tests.conftest import arm_urdf
from tests.support.sampled_cases import as_arrays, in_the_robots_axes, sampled, sampled_config
from tests.support.short_cases import short

NOISE_RAD_S, NOISE_M_S2, NOISE_TURN_RAD, NOISE_RAD = 2e-4, 3e-3, 2e-5, 1e-5
CHOICES = {"tool": "gripper", "prior": {"target": {"mass_kg": 2.0}}}


@dataclass(frozen=True)
class Arrays:
    setup: Setup
    config: Path
    held: dict[str, np.ndarray]

    def samples(self, **changes: Any) -> fsw.Samples:
        return fsw.Samples(**(self.held | changes))


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Arrays:
    folder = tmp_path_factory.mktemp("lab")
    setup = prepare(short(folder, hurry=2.0), 1, folder)
    config = sampled_config(setup)
    return Arrays(setup, config, as_arrays(*sampled(setup, config, 1)))


def imported(lab: Arrays, folder: Path) -> Path:
    """Return the recording that `fsw import` makes of the arrays in an .npz file."""
    np.savez(folder / "data.npz", **lab.held)
    mapping = {
        "joints": {
            "time": {"column": "t_s", "unit": "s"},
            "position": {"columns": "q", "unit": "rad"},
            "torque": {"columns": "tau", "unit": "N m"},
        },
        "imu": {
            "time": {"column": "t_imu_s", "unit": "s"},
            "rate": {"columns": "gyro_rad_s", "unit": "rad/s"},
            "specific_force": {"columns": "specific_force_m_s2", "unit": "m/s2"},
        },
    }
    (folder / "map.yaml").write_text(yaml.safe_dump(mapping))
    out = folder / "out.mcap"
    files = ["--map", str(folder / "map.yaml"), "--config", str(lab.config), "--out", str(out)]
    assert main(["import", str(folder / "data.npz"), *files]) == 0
    return out


def test_arrays_give_the_estimate_of_a_recording_of_them(lab, tmp_path, capsys):
    main(["identify", str(imported(lab, tmp_path)), "--config", str(lab.config), "--json"])
    theirs = json.loads(capsys.readouterr().out.splitlines()[-1])
    ours = fsw.identify(lab.samples(), fsw.Robot(lab.config))
    assert (ours.status, ours.names) == (theirs["status"], tuple(theirs["names"]))
    np.testing.assert_array_equal(ours.mean, theirs["mean"])
    np.testing.assert_array_equal(ours.covariance, theirs["covariance"])
    assert re.search(r"joints: \d+ samples in", str(ours)), "what was read is said"


def test_a_robot_in_code_finds_the_body(lab):
    data = yaml.safe_load(lab.config.read_text())
    robot = fsw.Robot.from_urdf(
        lab.config.parent / data["robot"]["urdf"],
        tool=data["robot"]["tool_frame"],
        prior={"target": data["bodies"]["target"]},
        settings={
            "imu": {"mounting": data["imu"]["mounting"] | {"q_BS_xyzw": [0, 0, 0, 1]}},
            "estimator": {"settle_blocks": 20},
        },
    )
    t_s = np.arange(1.0, lab.held["t_s"][-1], 0.2)
    turns = Rotation.from_matrix(lab.setup.history.at(t_s).R_NB)
    noise = np.random.default_rng(5).normal(0.0, NOISE_TURN_RAD, (len(t_s), 3))
    samples = fsw.Samples(
        **in_the_robots_axes(lab.held, lab.config),
        q_NB_xyzw=(turns * Rotation.from_rotvec(noise)).as_quat(),
        t_attitude_s=t_s,
    )
    found = fsw.identify(samples, robot)
    assert found.valid, str(found)
    mass_kg, *rest = lab.setup.scenario.truth["target"]
    truth = mass_kg, rest[:3], rest[3:]
    for key, true in zip(("mass_kg", "com_m", "inertia_kg_m2"), truth, strict=True):
        estimate, sigma = (found.values[name]["target"][key] for name in ("estimate", "sigma"))
        assert np.abs(np.subtract(estimate, true) / sigma).max() < 4.0, (key, str(found))


def reversed_torque(lab: Arrays) -> fsw.Samples:
    return lab.samples(tau=lab.held["tau"] * np.array([1.0, -1.0, *[1.0] * 5]))


def test_check_finds_in_arrays_what_the_command_finds_in_their_recording(lab, tmp_path, capsys):
    recording = imported(lab, tmp_path)
    capsys.readouterr()
    assert main(["check", str(lab.config), str(recording)]) == 0
    theirs = capsys.readouterr().out.splitlines()[:-1]  # the last line names the file
    found = fsw.check(lab.samples(), fsw.Robot(lab.config))
    assert found.agree
    assert list(found.lines) == theirs
    assert str(found).splitlines()[-1] == f"samples and {lab.config} agree"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"tau": -1.0}, "(joint2): its torque alone counts the other way"),
        ({"q": 180.0 / np.pi}, "the angles are in degrees, not in rad"),
        ({"gyro_rad_s": 180.0 / np.pi}, "its rates are in degrees/s, not in rad/s"),
    ],
)
def test_check_names_the_mistake_in_an_array(lab, change, words):
    (name, factor), scale = *change.items(), np.ones(7)
    if name == "tau":
        scale[1] = factor
    else:
        scale[:] = factor
    values = lab.held[name]
    found = fsw.check(
        lab.samples(**{name: values * scale[: values.shape[1]]}), fsw.Robot(lab.config)
    )
    assert not found.agree
    assert any("WRONG" in line and words in line for line in found.lines), str(found)


def test_a_clock_that_differs_is_a_shift_of_the_times(lab):
    """There is no `fsw import` of arrays."""
    shifted = lab.samples(t_imu_s=lab.held["t_imu_s"] + 0.03)
    found = fsw.check(shifted, fsw.Robot(lab.config))
    assert re.search(r"add (-0.0\d+) s to its stamps \(t_imu_s \+ \1\)", str(found)), str(found)
    assert "fsw import" not in str(found)


def test_a_result_of_arrays_names_no_command(lab):
    found = fsw.identify(reversed_torque(lab), fsw.Robot(lab.config))
    text = f"{found} {json.dumps(found.values)}"
    assert not found.valid
    assert "fsw.check(samples, robot)" in text
    assert repr(found) == str(found), "a notebook shows the table"
    assert re.findall(r"fsw [a-z]+|--[a-z]+|CONFIG|\S*\.mcap", text) == []


def test_replay_and_report_of_arrays_name_no_command(lab, tmp_path):
    samples = reversed_torque(lab)
    found = fsw.replay(samples, fsw.Robot(lab.config), to_s=6.0)
    assert repr(found) == str(found)
    assert str(found).startswith("fused, unknown target: not valid"), "as the command prints it"
    page = fsw.report(samples, fsw.Robot(lab.config), tmp_path / "page.html", to_s=6.0)
    for text in (str(found), repr(page), page.paths[0].read_text()):
        assert re.findall(r"--(?:from|to|config)\b|\S*\.mcap\b|fsw-recording", text) == []


def test_an_error_about_arrays_names_no_file(lab):
    with pytest.raises(FswError) as raised:
        fsw.identify(lab.samples(), fsw.Robot(lab.config), to_s=0.4)
    assert str(raised.value).startswith("samples: "), raised.value
    assert re.findall(r"fsw [a-z]+|--[a-z]+|CONFIG|\S*\.mcap", str(raised.value)) == []


def arm(folder: Path, **choices: Any) -> fsw.Robot:
    (folder / "arm.urdf").write_text(arm_urdf(3))
    return fsw.Robot.from_urdf(folder / "arm.urdf", **(CHOICES | choices))


def motion(rate_hz: float, noise: float, axes: int = 3) -> np.ndarray:
    """Return eight seconds of a gentle motion with noise."""
    rng = np.random.default_rng(3)
    t_s = np.arange(round(rate_hz * 8.0)) / rate_hz
    values = 0.1 * np.sin(0.5 * t_s[:, None] + np.arange(axes))
    return values + rng.normal(0.0, noise, values.shape)


def arrays(**changes: Any) -> fsw.Samples:
    held = {
        "t_s": np.arange(800) / 100.0,
        "q": motion(100.0, NOISE_RAD),
        "tau": motion(100.0, 0.05),
        "gyro_rad_s": motion(100.0, NOISE_RAD_S),
        "specific_force_m_s2": motion(100.0, NOISE_M_S2),
    }
    return fsw.Samples(**(held | changes))


def test_noise_and_delays_are_those_of_the_arrays(tmp_path):
    turns = Rotation.from_rotvec(motion(20.0, NOISE_TURN_RAD))
    samples = arrays(q_NB_xyzw=turns.as_quat(), t_attitude_s=np.arange(160) / 20.0)
    config = arm(tmp_path).fitted(samples).config
    imu, tracker = config.imu, config.star_tracker
    assert tracker is not None
    assert (imu.rate_hz, tracker.rate_hz, config.buses[0].rate_hz) == (100.0, 20.0, 100.0)
    delays = imu.gyro_group_delay_s, imu.acc_group_delay_s, tracker.latency_s
    assert delays == (0.0, 0.0, 0.0)
    near = {"rel": 0.2}  # of a known noise
    assert 10.0 * imu.angle_random_walk_rad_sqrt_s == pytest.approx(NOISE_RAD_S, **near)
    assert 10.0 * imu.velocity_random_walk_m_s_sqrt_s == pytest.approx(NOISE_M_S2, **near)
    assert tracker.noise_about_rad == pytest.approx(NOISE_TURN_RAD, **near)
    assert config.joints[0].position_noise_rad == pytest.approx(NOISE_RAD, **near)


def test_choices_hold_for_the_arrays_too(tmp_path):
    robot = arm(tmp_path).with_choices(method="rda").fitted(arrays())
    assert (robot.config.estimator.method, robot.config.imu.rate_hz) == ("rda", 100.0)


def test_sensors_without_arrays_are_not_there(tmp_path):
    samples = arrays(tau=None, gyro_rad_s=None, specific_force_m_s2=None)
    config = arm(tmp_path, base="clamped").fitted(samples).config
    assert {joint.torque for joint in config.joints} == {"none"}
    assert (config.imu.present, config.star_tracker) == (False, None)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"q": np.zeros(800)}, "samples: q: of shape (800,); must be (8 rows or more, one for"),
        ({"tau": np.zeros((799, 3))}, "samples: tau: 799 rows, and t_s has 800"),
        ({"gyro_rad_s": None}, "specific_force_m_s2: given without gyro_rad_s"),
        ({"gyro_rad_s": "fast"}, "samples: gyro_rad_s: 'fast' must be numbers"),
        (
            {"q": np.zeros((3, 800))},
            "of shape (3, 800); must be (8 rows or more, one for each joint); is it transposed?",
        ),
        ({"q": np.zeros((800, 2))}, "samples: q: 2 columns; must be 3, one for each of axis1"),
        ({"gyro_rad_s": None, "specific_force_m_s2": None}, "gyro_rad_s: missing; only"),
        ({"q": np.full((800, 3), np.nan)}, "samples"),
        ({"q": np.zeros((800, 3), complex)}, "samples: q: complex128; must be real numbers"),
        ({"q": np.zeros((800, 3), bool)}, "samples: q: bool; must be real numbers"),
        ({"t_s": np.zeros(800)}, "samples: t_s: 0 of 799 steps go forward"),
        ({"t_s": np.arange(800.0) * 10.0}, "samples: t_s: 0.1 Hz; must be seconds"),
        ({"t_imu_s": np.arange(800.0) * 5.0}, "samples: t_imu_s: 0.2 Hz; must be seconds"),
    ],
)
def test_arrays_that_cannot_be_are_one_line(tmp_path, changes, words):
    robot = arm(tmp_path)
    with pytest.raises(ConfigError, match=re.escape(words)) as raised:
        fsw.identify(arrays(**changes), robot)
    assert len(str(raised.value).splitlines()) == 1


def test_masked_values_are_missing():
    angles = np.ma.masked_array(arrays().q, mask=False)
    angles[5:9, 1] = np.ma.masked
    kept = np.isfinite(arrays(q=angles).q)
    assert not kept[5:9, 1].any()
    assert kept.sum() == kept.size - 4


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"tool": "hand"}, "tool: 'hand' must be one of"),
        ({"unknown": "both", "base": "clamped"}, "unknown: 'both'; a clamped base cannot be found"),
        ({"prior": {"target": {"mass_kg": -1.0}}}, "prior: target.mass_kg: -1 must be positive"),
        ({"base": "held"}, "base: 'held' must be one of free"),
        ({"prior": {}}, "prior: 'target' missing; it needs at least mass_kg"),
        ({"prior": {"target": {"mass_kg": "heavy"}}}, "target.mass_kg: 'heavy' must be a"),
        ({"prior": 2.0}, "prior: 2.0 must be a dict of bodies, {'target': {'mass_kg': ...}}"),
        ({"prior": {"target": 2.0}}, "prior: {'target': 2.0} must be a dict of bodies, {'target'"),
        ({"settings": {"imu": {"colour": 3}}}, "imu.colour: unknown key"),
        ({"unknown": ()}, "unknown"),
    ],
)
def test_a_robot_that_cannot_be_is_one_line(tmp_path, choices, words):
    with pytest.raises(ConfigError, match=rf"(?s)^(?!--).*{re.escape(words)}"):
        arm(tmp_path, **choices)


def test_numbers_of_numpy_are_numbers(tmp_path):
    prior = {"target": {"mass_kg": np.float32(2.0), "com_m": np.array([0.0, 0.0, 0.1])}}
    mounting = {"p_BS_m": np.ones(3)}
    robot = arm(tmp_path, prior=prior, settings={"imu": {"mounting": mounting}})
    assert (robot.config.bodies["target"].mass_kg, robot.config.imu.mounting.p_BS_m[0]) == (2, 1)


def test_the_text_of_a_urdf_is_no_path():
    with pytest.raises(ConfigError, match="urdf: is the text of a URDF; must be its path") as said:
        fsw.Robot.from_urdf(arm_urdf(3), **CHOICES)
    assert len(str(said.value)) < 100


def test_what_is_no_recording_is_one_line(tmp_path):
    with pytest.raises(ConfigError, match=r"recording: a dict must be a path or Samples\(t_s="):
        fsw.identify({"t_s": [0.0]}, arm(tmp_path))
    with pytest.raises(ConfigError, match=r"^to_s: -1 must be greater than from_s 0$"):
        fsw.identify(arrays(), arm(tmp_path), to_s=-1.0)


def test_exchanged_arguments_are_one_short_line(tmp_path):
    with pytest.raises(ConfigError, match="must be a Robot") as raised:
        fsw.identify(arm(tmp_path), arrays())
    assert len(str(raised.value)) < 200
    assert "\n" not in str(raised.value)


def test_arrays_need_a_robot():
    with pytest.raises(ConfigError, match=re.escape("Robot.from_urdf")):
        fsw.identify(arrays())


def test_a_wrong_sign_that_wide_priors_hide_is_found(tmp_path):
    """Friction and noise of a torque sensor are wide, and all residuals below 3 times the noise."""
    urdf = arm_urdf(3)
    for name, axis in (("axis1", "0 0 1"), ("axis2", "0 1 0"), ("axis3", "1 0 0")):
        head, at, tail = urdf.partition(f'name="{name}"')
        urdf = head + at + re.sub('axis xyz="[^"]*"', f'axis xyz="{axis}"', tail, count=1)
    (tmp_path / "turned.urdf").write_text(urdf)
    robot = fsw.Robot.from_urdf(tmp_path / "turned.urdf", base="clamped", **CHOICES)
    model, t_s, rng = pin.buildModelFromXML(urdf), np.arange(2500) / 100.0, np.random.default_rng(1)
    rate = 0.5 * np.arange(1.0, 4.0)
    phase = rate * t_s[:, None] + np.arange(3)
    motion = zip(np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase), strict=True)
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *own) for own in motion])
    tau += rng.normal(0.0, 0.5, tau.shape)
    right, wrong = (
        fsw.check(fsw.Samples(t_s=t_s, q=np.sin(phase) * turn, tau=tau * turn), robot)
        for turn in (np.ones(3), np.array([1.0, 1.0, -1.0]))
    )
    assert right.agree, right
    assert "without noise, as of a simulation" in str(right)
    assert "joints.2.sign (axis3): 1 should be -1" in str(wrong)
    assert "residuals" in wrong.lines[-1], wrong
    assert "fit (" not in wrong.lines[-1], wrong
