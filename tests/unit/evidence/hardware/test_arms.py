"""Recorded arms: one declaration each, their tables, and the judgement of what is claimed."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from evidence.hardware.arms import Arm, Motion, Run
from evidence.hardware.command import _with_ratios, declared, run
from evidence.hardware.data_set import DataSet
from evidence.hardware.judge import Result
from evidence.hardware.prepared import CONFIG, MAPPING, import_motion, prepare

ONE_JOINT = b"""<robot name="one"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="j" type="revolute">
<parent link="base"/><child link="tool"/><axis xyz="0 1 0"/>
<limit effort="20" velocity="2" lower="-3" upper="3"/></joint>
<link name="tool"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>"""


def motion() -> Motion:
    t = np.arange(300) * 0.01
    return Motion(t, np.sin(t)[:, None], np.cos(t)[:, None])


def arm() -> Arm:
    return Arm(
        name="one",
        data_sets=[],
        urdf=lambda _: ONE_JOINT,
        tool="tool",
        guess_kg=1.0,
        rate_hz=100.0,
        joints=["j"],
        runs=[Run(name="only", payload_kg=1.5, motion=lambda _: motion())],
        torque={"scale": 2.0, "sign": -1},
    )


def result(**values: object) -> Result:
    known = {"case": "x, naive", "configuration": "naive", "payload_kg": 1.0, "held_out": False}
    return Result(**(known | {"status": "OK", "mass_kg": 1.0, "mass_sigma_kg": 0.1} | values))


def test_every_declared_arm_names_its_runs_and_their_empty_ones():
    for own in declared().values():
        names = [each.name for each in own.runs]
        assert len(set(names)) == len(names)
        for each in own.runs:
            assert each.alone or each.empty is not None
            empty = [other for other in own.runs if other.name == each.empty]
            assert all(other.payload_kg == 0.0 for other in empty)
            assert (each.empty is None) == (not empty)
        for data_set in own.data_sets:
            assert all(len(sha256) == 64 for sha256 in data_set.files.values())
            assert len(data_set.commit) == 40


def test_two_runs_of_each_of_the_three_arms_are_held_out():
    for robot in ("ur10e", "gen3", "iiwa14"):
        arms = [own for name, own in declared().items() if name.startswith(robot)]
        assert sum(each.held_out for own in arms for each in own.runs) == 2


def test_a_table_has_the_columns_of_the_mapping(tmp_path: Path):
    own = motion().part(0.5, 1.0)
    own.write(tmp_path / "motion.csv", ["j"])
    with (tmp_path / "motion.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 150
    assert float(rows[0]["t_s"]) == 1.5
    assert abs(float(rows[4]["tau_j"]) - own.tau[4, 0]) < 1e-8


def test_an_arm_becomes_a_configuration_and_a_recording(tmp_path: Path):
    config = prepare(arm(), lambda *_: b"", tmp_path)
    assert config == tmp_path / CONFIG
    assert "sign: -1" in (tmp_path / MAPPING).read_text(encoding="utf-8")
    assert import_motion(arm(), motion(), config, tmp_path / "only").stat().st_size > 1000


def table(rows: list[list[str]]) -> bytes:
    return "\n".join(",".join(row) for row in rows).encode()


def test_damaged_lines_of_a_log_are_left_out():
    """Three lines of another clock before the motion, and a last line that is cut."""
    rows = [[f"{900 + k * 0.01:.2f}", *(["0.5"] * 30)] for k in range(9)]
    noise = [[clock, *(["0.1"] * 30)] for clock in ("3047.7", "-0.1", "0.8")]
    found = declared()["ur10e"].runs[0].motion(lambda *_: table([*noise, *rows, rows[0][:20]]))
    assert np.allclose(found.t_s, 0.01 * np.arange(9))
    assert found.q_rad.shape == found.tau.shape == (9, 6)


def test_parts_of_a_motion_are_put_one_behind_the_other():
    def read(_: DataSet, path: str) -> bytes:
        times = "0\n0.005\n0.01\n0\n0.005\n"
        return times.encode() if "time" in path else b"1 2 3 4 5 6 7\n" * 5

    found = declared()["iiwa14"].runs[0].motion(read)
    assert np.allclose(found.t_s, 0.005 * np.arange(5))


def test_sensor_and_current_of_one_log_are_two_runs():
    head = [f"c{k}" for k in range(40)]
    data = table([head, [str(k) for k in range(40)]])
    arms = declared()["gen3-sensor"], declared()["gen3-current"]
    runs = {own.name: own.motion(lambda *_: data) for each in arms for own in each.runs}
    assert runs["opti_traj_testing1-sensor"].tau[0].tolist() == list(range(22, 29))
    assert runs["opti_traj_testing1-current"].tau[0].tolist() == list(range(29, 36))


@pytest.mark.parametrize(
    ("values", "verdict"),
    [
        ({"claim": "measured", "mass_kg": 1.29}, "ok"),
        ({"claim": "measured", "mass_kg": 1.31}, "WRONG"),
        ({"claim": "not valid", "mass_kg": 9.0, "status": "MODEL_MISMATCH"}, "refused"),
        ({"claim": "measured", "mass_kg": 1.31, "status": "INSUFFICIENT_EXCITATION"}, "WRONG"),
        ({"payload_kg": 0.0, "mass_kg": 0.19, "nees": 10.0}, "ok"),
        ({"payload_kg": 0.0, "mass_kg": 0.21, "nees": 10.0}, "refused"),
        ({"payload_kg": 0.0, "mass_kg": 0.1, "nees": 30.0}, "refused"),
        ({"payload_kg": 0.0, "mass_kg": -0.31, "nees": 10.0}, "WRONG"),
        ({"status": "a line of an error", "mass_kg": float("nan")}, "refused"),
        ({"claim": "measured", "mass_sigma_kg": float("nan")}, "WRONG"),
    ],
)
def test_a_claim_is_judged_by_the_known_payload(values: Mapping[str, object], verdict: str):
    assert result(**values).verdict == verdict


def test_sigma_is_compared_with_the_best_configuration():
    naive, best = result(), result(case="x, best", configuration="best", mass_sigma_kg=0.05)
    assert [own.sigma_ratio for own in _with_ratios([naive, best])] == [2.0, 1.0]
    assert np.isnan(_with_ratios([naive])[0].sigma_ratio)


def test_without_data_the_command_ends_in_one_line(tmp_path: Path, capsys):
    assert run(tmp_path, throws=False, fetch=False, out=None, as_json=False) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert run(tmp_path, throws=False, fetch=False, out=None, as_json=False, arms=["no"]) == 2
    assert "must be one of gen3-current, " in capsys.readouterr().err
