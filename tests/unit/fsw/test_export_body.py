"""An identified body in the formats of other tools, read back by those tools."""

from __future__ import annotations

import csv
import io
import json
import xml.etree.ElementTree as ET
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from fsw.__main__ import main
from fsw.estimators.model.inertia import NAMES

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
