"""Scenarios: what the flight side is told holds no truth, and is possible."""

import re
import shutil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from hil.run.bench import span_s
from hil.world.base_urdf import replace_base
from hil.world.prior import draw_prior
from hil.world.scenario import (
    ScenarioError,
    load,
    mapping_from,
    names,
    report_from,
)
from hil.world.spline import JointSpline

INSPECTOR = Path(__file__).parents[4] / "docs" / "inspector"


def test_the_four_scenarios_load():
    assert set(names()) >= {"target_leo", "target_geo", "base", "both"}
    for name in names():
        scenario = load(name)
        assert scenario.urdf.is_file()
        assert scenario.identification.is_file(), scenario.identification
        assert scenario.verification.is_file(), scenario.verification
        assert scenario.identification != scenario.verification
        assert set(scenario.unknown) <= set(scenario.truth)


@pytest.mark.parametrize(("name", "rests"), [("target_leo", True), ("panel_leo", False)])
def test_liquid_and_panels_swing_on_after_the_motion(name: str, rests: bool):
    """The plant holds the last state of a robot that rests; a panel must not stop with the arm."""
    scenario = load(name)
    assert scenario.rests is rests
    _, end_s = span_s(scenario, JointSpline.load(scenario.identification))
    assert (end_s >= 60.0 + scenario.after_s) is not rests


def test_the_flight_robot_file_has_the_given_base():
    scenario = load("base")
    report = draw_prior(scenario.truth["base"], 0, "base").report
    root = ElementTree.fromstring(replace_base(scenario.urdf, report))
    link = root.find("link[@name='base']")
    assert len(link.findall("inertial")) == 1
    assert float(link.find("inertial/mass").get("value")) == report[0]
    assert float(link.find("inertial/inertia").get("iyz")) == report[8]
    original = ElementTree.parse(scenario.urdf).getroot()
    assert len(root.findall("link")) == len(original.findall("link"))


def test_report_and_mapping_are_inverse():
    report = np.arange(1.0, 11.0)
    np.testing.assert_array_equal(report_from(mapping_from(report)), report)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"surprise": 1}, "surprise"),
        ({"unknown": []}, "unknown"),
        ({"unknown": ["moon"]}, "unknown"),
        ({"bodies": {"base": "nowhere"}}, "nowhere"),
    ],
)
def test_a_wrong_scenario_is_refused_by_name(tmp_path, change, named):
    scenario = load("target_leo")
    document = {
        "title": "t",
        "robot": {"urdf": str(scenario.urdf), "tool_frame": "tool"},
        "bodies_file": str(scenario.urdf.parent / "bodies.yaml"),
        "bodies": {"base": "base", "target": "target_leo"},
        "unknown": ["target"],
        "trajectories": {"identification": "a.yaml", "verification": "b.yaml"},
        "timing": {"before_s": 0, "after_s": 0},
        "sensors": {},
        "flight": {},
    }
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(document | change), encoding="utf-8")
    with pytest.raises(ScenarioError, match=named):
        load(str(path))


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("encoder_bits", "encoder_bit", "encoder_bit: unknown key; did you mean 'encoder_bits'?"),
        ("sign: -1", "sgn: -1", "joints.nodes.2.sgn: unknown key; did you mean 'sign'?"),
        ("before_s", "befor_s", "timing.befor_s: unknown key; did you mean 'before_s'?"),
        ("identification: plan", "identification: p", "trajectories.identification: p.yaml: no"),
        ("urdf: inspector", "urdf: robot", "robot.urdf: robot.urdf: no such file"),
        ("noise_nm: 0.03", "noise_nm: x", 'torque_noise_nm: must be a number (value: "x")'),
        ("range_g: 10", "range_g: 7", "acc_range_g: must be 5, 10, 30 or 80 (value: 7)"),
        ("before_s: 3.0", "before_s: -3", "timing.before_s: must be at least 0 (value: -3)"),
        ("[0.1, 0.2, -0.4]", "[0.1, 0.2]", "imu.p_BS_m: entry 3 is missing"),
        ("[0.1, 0.2, -0.4]", "[0, 0, 0, 0]", "must have at most 3 entries (value: [0, 0, 0, 0])"),
        ("{node_id: 0x11}", "0x11", "joints.nodes.0: must be a section of keys and values"),
        (
            "q_BS_xyzw: [0.0, 0.0",
            "rpy_BS_rad: [0, 90",
            "imu.rpy_BS_rad: must be three angles of at",
        ),
    ],
)
def test_a_slip_in_a_scenario_is_named_with_its_key(tmp_path, old, new, told):
    path = shutil.copytree(INSPECTOR, tmp_path / "own") / "world.yaml"
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ScenarioError) as caught:
        load(str(path))
    assert told in str(caught.value)
    assert len(str(caught.value)) < 300 + len(str(path))
    assert not re.search("Input should|\n|type=|Value error|pydantic", str(caught.value))


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("robot.yaml", "a configuration of the daemon"),
        ("inspector.urdf", "XML, such as a URDF"),
        ("plan.yaml", "a motion"),
        ("limits.yaml", "the limits of a motion"),
        ("bodies.yaml", "timing, title, trajectories, unknown are missing"),
        ("none.yaml", "no such file"),
    ],
)
def test_another_file_is_told_as_what_it_is(tmp_path, name, told):
    folder = shutil.copytree(INSPECTOR, tmp_path / "own")
    (folder / "robot.yaml").write_text("robot: {}\nbuses: {}\njoints: []\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match=told) as caught:
        load(str(folder / name))
    assert len(str(caught.value).splitlines()) == 1


def test_an_unknown_name_lists_what_there_is():
    with pytest.raises(ScenarioError, match="target_leo"):
        load("nothing")
