"""`fsw view` of a flight and of a plan: poses and ellipsoids as the model has them."""

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.spatial.transform import Rotation

from fsw.__main__ import main
from fsw.config import load
from fsw.estimators.model.inertia import to_parameters
from fsw.estimators.model.robot import RobotModel
from hil.world.spline import JointSpline
from offline.replay import replay
from offline.report.collect import Collector
from offline.view import write

MOST_BYTES = 10_000_000
POSE = 1e-6  # m, and of a rotation matrix


def scene_of(path):
    text = path.read_text(encoding="utf-8")
    assert len(text) < MOST_BYTES
    assert "Permission is hereby granted" in text, "the viewer's licence"
    assert "https://" not in re.sub(r"<script>.*?</script>", "", text, flags=re.S)
    inside = re.search(r'type="application/json">(.*?)</script>', text, re.S)
    assert inside is not None
    return json.loads(inside[1])


def homogeneous(frame, k):
    X = np.eye(4)
    X[:3, :3] = Rotation.from_quat(frame["q"][4 * k : 4 * k + 4]).as_matrix()
    X[:3, 3] = frame["p"][3 * k : 3 * k + 3]
    return X


def model_with(config, bodies):
    """Return the robot with these bodies (mass, centre, inertia) in their frames."""
    model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
    target = to_parameters(*bodies["target"])
    model.set_parameters(model.total_parameters(model.pi_links[:10], target))
    return model


@pytest.fixture(scope="module")
def replayed(flown):
    """Return the configuration, the windows and the estimates of the flight."""
    config = load(flown / "flight.yaml")
    sink = Collector()
    result = replay(flown / "recording.mcap", config, sink=sink)
    return config, sink.blocks, sink.estimates, result


@pytest.fixture(scope="module")
def shown(flown, tmp_path_factory):
    out = tmp_path_factory.mktemp("view") / "motion.html"
    truth = out.with_name("truth.json")
    truth.write_text(json.dumps({"target": {"mass_kg": 400.0, "com_m": [0.7, 0.5, 0.4]}}))
    arguments = ["--truth", str(truth), "--out", str(out)]
    assert main(["view", str(flown / "recording.mcap"), *arguments]) == 0
    return scene_of(out)


def test_poses_are_those_of_the_forward_kinematics(replayed, shown):
    config, blocks, estimates, result = replayed
    last = estimates[-1].bodies["target"]
    robot = model_with(config, {"target": (last.mass_kg, last.com_m, last.inertia_kg_m2)})
    data = robot.model.createData()
    times_s = np.array(shown["frames"][0]["t"])
    for block in (blocks[0], blocks[len(blocks) // 3], blocks[-1]):
        for node in (0, len(block.t_ns) - 1):
            k = int(np.argmin(np.abs(times_s - (block.t_ns[node] - result.start_ns) * 1e-9)))
            base = homogeneous(shown["frames"][0], k)
            assert base[:3, :3] == pytest.approx(block.R_NB[node], abs=POSE)
            pose = np.r_[
                base[:3, 3], Rotation.from_matrix(block.R_NB[node]).as_quat(), block.q_rad[node]
            ]
            pin.forwardKinematics(robot.model, data, pose)
            for frame, placed in zip(shown["frames"], list(data.oMi)[1:], strict=True):
                assert homogeneous(frame, k) == pytest.approx(placed.homogeneous, abs=POSE)
            com = pin.centerOfMass(robot.model, data, pose)
            assert com == pytest.approx(np.zeros(3), abs=POSE), "it rests in the origin"
    assert [frame["path"] for frame in shown["frames"][1:]] == [
        f"/robot/{name}" for name in robot.joint_names
    ]
    assert shown["duration_s"] == times_s[-1]


def test_ellipsoids_are_those_of_the_covariance_and_the_truth_stands_beside(replayed, shown):
    config, _, estimates, _ = replayed
    (body,) = shown["bodies"]
    model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame).model
    place = model.frames[model.getFrameId(config.robot.tool_frame)].placement
    assert len(body["t"]) == len(estimates)
    for k in (1, len(estimates) // 2, len(estimates) - 1):
        e = estimates[k]
        row = [e.names.index(f"target.{name}") for name in ("m", "mcx", "mcy", "mcz")]
        P, h = e.covariance[np.ix_(row, row)], e.mean[row]
        c = h[1:] / h[0]
        J = np.c_[-c, np.eye(3)] / h[0]  # d(h / m) by m and h
        values, _ = np.linalg.eigh(J @ P @ J.T)
        semi = np.array(body["semi"][3 * k : 3 * k + 3])
        assert np.sort(semi) == pytest.approx(3.0 * np.sqrt(values), rel=1e-6)
        R = place.rotation.T @ Rotation.from_quat(body["q"][4 * k : 4 * k + 4]).as_matrix()
        rebuilt = R @ np.diag((semi / 3.0) ** 2) @ R.T
        assert rebuilt == pytest.approx(J @ P @ J.T, rel=1e-5, abs=1e-6 * values[-1])
        centre = place.act(e.bodies["target"].com_m)
        assert body["p"][3 * k : 3 * k + 3] == pytest.approx(centre, abs=POSE)
        assert bool(body["reasons"][k]) != e.valid
    assert body["truth"]["p"] == pytest.approx(place.act(np.array([0.7, 0.5, 0.4])), abs=POSE)
    assert body["path"] == shown["frames"][-1]["path"]


def test_a_plan_moves_the_base_without_momentum(flown, tmp_path):
    config = load(flown / "flight.yaml")
    out = tmp_path / "plan.html"
    plan, told = str(flown / "motion.yaml"), ["--config", str(flown / "flight.yaml")]
    assert main(["view", plan, *told, "--out", str(out)]) == 0
    shown = scene_of(out)
    prior = config.bodies["target"]
    bodies = {"target": (prior.mass_kg, np.array(prior.com_m), np.array(prior.inertia_kg_m2))}
    robot = model_with(config, bodies)
    data, times_s = robot.model.createData(), np.array(shown["frames"][0]["t"])
    moving, most = [], 0.0
    for k in range(1, len(times_s) - 1, 20):
        before, after = (homogeneous(shown["frames"][0], k + step) for step in (-1, 1))
        h = times_s[k + 1] - times_s[k - 1]
        R = homogeneous(shown["frames"][0], k)[:3, :3]
        w = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).as_rotvec() / h
        v = R.T @ (after[:3, 3] - before[:3, 3]) / h
        q, qd = joints_of(plan, times_s[k])
        pose = np.r_[
            homogeneous(shown["frames"][0], k)[:3, 3], Rotation.from_matrix(R).as_quat(), q
        ]
        total = pin.computeCentroidalMomentum(robot.model, data, pose, np.r_[v, w, qd]).angular
        alone = pin.computeCentroidalMomentum(
            robot.model, data, pose, np.r_[np.zeros(6), qd]
        ).angular
        moving.append(np.linalg.norm(total))
        most = max(most, float(np.linalg.norm(alone)))
    assert most > 1.0, "the arm moves"
    assert max(moving) < 1e-3 * most
    (body,) = shown["bodies"]
    assert body["times"] == [1.0]
    assert sorted(body["semi"])[-1] > 0.1, "the prior"


def joints_of(plan, t_s):
    q, qd, *_ = JointSpline.load(Path(plan)).evaluate(np.array([t_s]))
    return q[0], qd[0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{flown}/motion.yaml"], "--config"),
        (["{flown}/flight.yaml", "--config", "{flown}/flight.yaml"], "degree: 5"),
        (["{flown}/recording.mcap", "--truth", "nowhere.json"], "nowhere.json"),
        (["{flown}/nowhere.mcap"], "nowhere.mcap"),
        (["{tmp}/short.yaml", "--config", "{flown}/flight.yaml"], "moves 2 joints; the robot has"),
        (["{flown}/motion.yaml", "--config", "{flown}/flight.yaml", "--out", "/proc/x.html"],
         "/proc/x.html: cannot be written"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line(flown, tmp_path, capsys, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    short = {"degree": 5, "duration_s": 2.0, "control_points_rad": [[0.0, 0.0]] * 8}
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(short))
    assert main(["view", *(a.format(flown=flown, tmp=tmp_path) for a in arguments)]) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("fsw: ")
    assert words in last
    assert not list(tmp_path.glob("*.html"))


def test_without_its_extra_it_says_what_to_install(flown, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(write, "find_spec", lambda _name: None)
    assert importlib.util.find_spec("meshcat") is not None
    assert main(["view", str(flown / "recording.mcap")]) == 2
    told = capsys.readouterr().err.splitlines()
    assert told == ["fsw: fsw view needs meshcat: pip install 'inertia-daemon[view]'"]
