"""An identified body in the formats of other tools, read back by those tools."""

import csv
import io
import json
import sys
import xml.etree.ElementTree as ET
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from fsw.__main__ import main
from fsw.estimators.model.inertia import NAMES
from offline.identified_body import body_of

MASS, COM = 80.25, [0.1, -0.02, 0.4]
INERTIA = [6.0, 0.3, -0.2, 5.0, 0.1, 4.0]
MATRIX = np.array([[6.0, 0.3, -0.2], [0.3, 5.0, 0.1], [-0.2, 0.1, 4.0]])


@pytest.fixture
def result(tmp_path) -> Any:
    values = {
        "status": "OK",
        "estimate": {"target": {"mass_kg": MASS, "com_m": COM, "inertia_kg_m2": INERTIA}},
        "names": ["joint.offset", *(f"target.{name}" for name in NAMES)],
        "covariance": np.diag([9.0, 0.04, *[1e-4] * 9]).tolist(),
    }
    path = tmp_path / "result.json"
    path.write_text(json.dumps(values))
    return values, path


def written(path, kind, capsys) -> str:
    assert main(["export", str(path), "--format", kind]) == 0
    return capsys.readouterr().out


def test_pinocchio_reads_the_urdf(result, capsys):
    text = written(result[1], "urdf", capsys)
    inertia = pin.buildModelFromXML(text, pin.JointModelFreeFlyer()).inertias[1]
    assert inertia.mass == pytest.approx(MASS, rel=1e-12)
    np.testing.assert_allclose(inertia.lever, COM, atol=1e-12)
    np.testing.assert_allclose(inertia.inertia, MATRIX, atol=1e-12)


@pytest.mark.parametrize("kind", ["urdf", "mjcf"])
def test_mujoco_reads_it(result, capsys, kind):
    model = mujoco.MjModel.from_xml_string(written(result[1], kind, capsys))
    R, body = np.empty(9), model.nbody - 1
    mujoco.mju_quat2Mat(R, model.body_iquat[body])
    R = R.reshape(3, 3)
    assert model.body_mass[body] == pytest.approx(MASS, rel=1e-12)
    np.testing.assert_allclose(model.body_ipos[body], COM, atol=1e-12)
    np.testing.assert_allclose(R @ np.diag(model.body_inertia[body]) @ R.T, MATRIX, atol=1e-12)


def test_the_sdf_holds_every_digit(result, capsys):
    inertial = ET.fromstring(written(result[1], "sdf", capsys)).find("model/link/inertial")
    assert inertial is not None
    assert float(inertial.findtext("mass", "")) == MASS
    assert [float(x) for x in inertial.findtext("pose", "").split()] == [*COM, 0, 0, 0]
    moments = [float(part.text or "") for part in inertial.findall("inertia/*")]
    np.testing.assert_allclose(moments, INERTIA, atol=1e-12)


def test_tables_hold_values_and_sigmas(result, capsys):
    rows = list(csv.DictReader(io.StringIO(written(result[1], "csv", capsys))))
    assert [float(row["value"]) for row in rows] == pytest.approx([MASS, *COM, *INERTIA])
    assert float(rows[0]["sigma"]) == pytest.approx(0.2)
    payload = json.loads(written(result[1], "json", capsys))
    assert payload["covariance"][0][0] == pytest.approx(0.04)
    assert payload["frame"] == "tool"


def test_parquet_holds_the_table_and_the_verdict(result, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs the extra parquet")
    values, path = result
    path.write_text(json.dumps(values | {"status": "MODEL_MISMATCH"}))
    out = tmp_path / "body.parquet"
    assert main(["export", str(path), "--format", "parquet", "--out", str(out)]) == 1
    table, body = parquet.read_table(out), body_of(values, "target")
    assert table.column("value").to_pylist() == [MASS, *body.com_m, *body.inertia_kg_m2]
    assert table.column("sigma")[0].as_py() == pytest.approx(0.2)
    np.testing.assert_array_equal(table.column("covariance").to_pylist(), body.covariance)
    facts = {"body": "target", "frame": "tool", "valid": "false", "reason": "MODEL_MISMATCH"}
    assert {k.decode(): v.decode() for k, v in table.schema.metadata.items()} == facts


def test_parquet_needs_pyarrow_and_a_file(result, tmp_path, capsys, monkeypatch):
    command = ["export", str(result[1]), "--format", "parquet"]
    assert main(command) == 2
    assert "--out FILE" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main([*command, "--out", str(tmp_path / "body.parquet")]) == 2
    error = capsys.readouterr().err
    assert "pip install 'inertia-daemon[parquet]'" in error
    assert len(error.splitlines()) == 1


def test_ros_2_reads_the_message_by_the_definition_that_is_exported(result, tmp_path, capsys):
    """To CDR bytes and back, by a parser and a serialiser that are not ours."""
    typesys = pytest.importorskip("rosbags.typesys", reason="needs rosbags: pip install '.[test]'")
    assert main(["export", "ros2", "--out", str(tmp_path / "new")]) == 0
    files = [
        tmp_path / "new" / name
        for name in ("msg/BodyEstimate.msg", "package.xml", "CMakeLists.txt")
    ]
    assert capsys.readouterr().out.splitlines() == [str(path) for path in files]
    package = ET.parse(files[1]).getroot()
    name = f"{package.findtext('name')}/msg/{files[0].stem}"
    assert f'"msg/{files[0].name}"' in files[2].read_text()
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    definition = typesys.get_types_from_msg(files[0].read_text(), name)
    store.register(definition)
    used = {kind.split("/")[0] for _, (_, kind) in definition[name][1] if isinstance(kind, str)}
    assert used == {depend.text for depend in package.findall("depend")}

    command = ["export", str(result[1]), "--format", "ros2", "--frame", "gripper"]
    assert main(command) == 0
    sent = built(store, name, json.loads(capsys.readouterr().out))
    read = store.deserialize_cdr(store.serialize_cdr(sent, name), name)
    body = body_of(result[0], "target")
    assert (read.header.frame_id, read.body, read.valid, read.reason) == (
        "gripper",
        "target",
        True,
        "",
    )
    inertia = read.inertia
    assert [inertia.m, inertia.com.x, inertia.com.y, inertia.com.z] == [MASS, *body.com_m]
    moments = (inertia.ixx, inertia.ixy, inertia.ixz, inertia.iyy, inertia.iyz, inertia.izz)
    np.testing.assert_array_equal(moments, body.inertia_kg_m2)
    np.testing.assert_array_equal(read.covariance.reshape(10, 10), body.covariance)


def built(store, name, values):
    """Return a message of plain values, as `ros2 topic pub` fills it from YAML: every field."""
    fields = dict(store.fielddefs[name][1])
    assert set(values) == set(fields)
    made = {}
    for field, value in values.items():
        if isinstance(value, dict):
            value = built(store, fields[field][1], value)  # noqa: PLW2901
        made[field] = np.array(value) if isinstance(value, list) else value
    return store.types[name](**made)


def test_an_impossible_body_is_exported_as_the_nearest_possible(result, capsys):
    values, path = result
    values["estimate"]["target"]["inertia_kg_m2"] = [1.0, 0.0, 0.0, 1.0, 0.0, 9.0]
    path.write_text(json.dumps(values))
    payload = json.loads(written(path, "json", capsys))
    xx, _, _, yy, _, zz = payload["inertia_kg_m2"]
    assert xx + yy >= zz


def test_an_estimate_that_is_not_valid_exits_with_1(result, capsys):
    values, path = result
    path.write_text(json.dumps(values | {"status": "MODEL_MISMATCH"}))
    assert main(["export", str(path)]) == 1
    assert "not valid" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["{}", "[]", "no", '{"estimate": {}}'])
def test_what_is_no_result_is_one_line(tmp_path, capsys, content):
    path = tmp_path / "x.json"
    path.write_text(content)
    assert main(["export", str(path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize(
    "damage",
    [
        lambda v: v["estimate"]["target"].update(mass_kg=float("nan")),
        lambda v: v["estimate"]["target"].update(mass_kg=0.0),
        lambda v: v["estimate"]["target"].update(mass_kg=1e308, com_m=[1e200, 0.0, 0.0]),
        lambda v: v["estimate"]["target"].update(com_m=[1.0, 2.0]),
        lambda v: v.update(covariance=[[float("nan")] * 11] * 11),
        lambda v: v.update(covariance=np.diag([-1.0] * 11).tolist()),
        lambda v: v.update(names=3),
    ],
)
def test_no_damaged_value_reaches_a_controller(result, capsys, damage):
    values, path = result
    damage(values)
    path.write_text(json.dumps(values))
    assert main(["export", str(path)]) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert len(error.splitlines()) == 1
