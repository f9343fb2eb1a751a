"""The command: files written, verdicts and exit codes."""

import json

import pytest
import yaml

from evidence.excitation import cases
from fsw.__main__ import main
from hil.world.spline import JointSpline
from tests.support.excitation_cases import LIMITS_FILE, SHORT, motion

QUICK = ["--duration-s", "10", "--iterations", "8", "--limits", str(LIMITS_FILE)]


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "flight.yaml"
    path.write_text(yaml.safe_dump(json.loads(cases.config("both").model_dump_json())))
    return str(path)


def test_it_plans_exports_and_judges_its_own_plan(config, tmp_path, capsys):
    out = tmp_path / "plan.yaml"
    assert main(["excite", config, "--unknown", "target", "--out", str(out), *QUICK]) == 0
    shown = capsys.readouterr()
    assert "predicted sigma" in shown.out
    assert "evaluation" in shown.err
    assert JointSpline.load(out).duration_s == 10.0
    assert (tmp_path / "plan.csv").exists()
    assert yaml.safe_load((tmp_path / "plan_joint_trajectory.yaml").read_text())["points"]
    assert (tmp_path / "plan.png").read_bytes().startswith(b"\x89PNG")
    judged = ["excite", config, "--evaluate", str(out), "--limits", str(LIMITS_FILE)]
    assert main([*judged, "--unknown", "target"]) == 0
    assert "BROKEN" not in capsys.readouterr().out


def test_check_says_what_a_motion_would_show(config, tmp_path, capsys):
    from planner import spline

    overlay, path = tmp_path / "target.yaml", tmp_path / "plan.yaml"
    overlay.write_text("unknown: [target]\n")
    spline.save(SHORT.trajectory(motion(size_rad=0.5)), path, {})
    assert main(["check", config, str(path), "--overlay", str(overlay)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("target.mass_kg: predicted sigma") for line in lines)
    assert lines[-1].startswith("target: every parameter measured; mass to ")
    judged = ["excite", config, "--evaluate", str(path), "--limits", str(LIMITS_FILE)]
    main([*judged, "--overlay", str(overlay)])
    again = capsys.readouterr().out.splitlines()
    assert [line for line in again if "predicted sigma " in line] == lines[-11:-1]
    path.write_text("degree: 5\nduration_s: 1.0\n")
    assert main(["check", config, str(path)]) == 2
    assert "control_points_rad" in capsys.readouterr().err


def test_a_motion_at_rest_shows_little(config, tmp_path, capsys):
    from planner import spline

    path = tmp_path / "rest.yaml"
    spline.save(SHORT.trajectory(motion(size_rad=0.0)), path, {})
    assert main(["check", config, str(path)]) == 0
    told = capsys.readouterr().out.splitlines()[-2:]
    assert all(
        "prior-dominated" in line and "every parameter measured" not in line for line in told
    )


def test_a_broken_limit_is_shown_and_fails(config, tmp_path, capsys):
    from planner import spline

    path = tmp_path / "wild.yaml"
    spline.save(SHORT.trajectory(motion(size_rad=0.5)), path, {})
    judged = ["excite", config, "--evaluate", str(path), "--limits", str(LIMITS_FILE)]
    assert main(judged) == 1
    assert "BROKEN joint_acceleration" in capsys.readouterr().out


def test_an_infeasible_request_fails_and_writes_nothing(config, tmp_path, capsys):
    limits = tmp_path / "limits.yaml"
    text = LIMITS_FILE.read_text().replace("torque_nm: 40.0", "torque_nm: 1.0e-6")
    limits.write_text(text)
    out = tmp_path / "plan.yaml"
    asked = ["excite", config, "--unknown", "target", "--out", str(out), *QUICK[:4]]
    assert main([*asked, "--limits", str(limits)]) == 1
    assert "infeasible" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(
    ("extra", "word"),
    [
        ([], "--limits"),
        (["--duration-s", "-1"], "--duration-s"),
        (["--weight", "target.mass=2"], "target.mass"),
        (["--weight", "target"], "NAME=NUMBER"),
        (["--weight", "target=0", "--weight", "base=0"], "all are zero"),
        (["--after", "/nowhere.json"], "cannot be read"),
        (["--evaluate", "/nowhere.yaml", "--limits", str(LIMITS_FILE)], "cannot be read"),
    ],
)
def test_a_wrong_argument_is_named(config, capsys, extra, word):
    assert main(["excite", config, "--out", "/tmp/never.yaml", *extra]) == 2
    assert word in capsys.readouterr().err
