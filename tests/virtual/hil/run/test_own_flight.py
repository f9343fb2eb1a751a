"""Flights with a configuration of one's own, nodes and mountings too; a planted mistake."""

from dataclasses import replace
from pathlib import Path

import yaml

from hil.judge import judgement
from hil.run import bench
from hil.run.own_flight import own_world
from hil.world.scenario import FOLDER
from tests.support.short_cases import IMU_RATE_HZ, RATE_HZ, NoMeter, short

OWN = FOLDER / "configurations" / "target_leo.yaml"
CHI2_10_999 = 29.6
WRONG = 3  # joint whose sign differs between configuration and device


def own_file(folder: Path, name: str, wrong: int | None = None) -> Path:
    """Write a configuration that differs from the scenario in nodes, signs, zeros and mountings."""
    document = yaml.safe_load(OWN.read_text(encoding="utf-8"))
    document["robot"]["urdf"] = str((OWN.parent / document["robot"]["urdf"]).resolve())
    document["buses"][0] |= {"name": "left", "rate_hz": RATE_HZ}
    document["scheduler"]["tick_rate_hz"] = RATE_HZ
    for k, joint in enumerate(document["joints"]):
        joint |= {"bus": "left", "node_id": 0x40 - 3 * k, "sign": -joint.get("sign", 1)}
        joint["zero_offset_rad"] = 0.1 * k
        if k == wrong:
            joint["sign"] = -joint["sign"]
    document["imu"]["mounting"] = {"p_BS_m": [0.2, 0.1, 0.3], "rpy_BS_rad": [0.4, -1.0, 2.0]}
    document["imu"]["rate_hz"] = IMU_RATE_HZ
    document["star_tracker"]["mounting"] = {"p_BS_m": [0, 0, 0], "rpy_BS_rad": [1.0, 0.3, -2.0]}
    path = folder / name
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


def flown(folder: Path, points: int, devices: str | None = None):
    path = own_file(folder, "own.yaml")
    told = None if devices is None else own_file(folder, devices, WRONG)
    scenario, own = own_world(short(folder, points), path, told, 1, folder / "run")
    setup = bench.prepare(scenario, 1, folder / "run", own=own)
    if told is not None:
        setup = replace(setup, exact=None)  # a replay that nobody looks at
    return setup, bench.run_virtual(setup, NoMeter(), record=False)


def test_the_target_is_found_with_ones_own_nodes_signs_and_mountings(tmp_path):
    setup, recorded = flown(tmp_path, 7)
    outcome = judgement.judge(setup, judgement.make_case(setup), recorded)
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < CHI2_10_999
    assert outcome["outputs"]["wrong"] == 0
    assert {counts["rejected"] + counts["lost"] for counts in outcome["samples"].values()} == {0}
    exact = outcome["exact"]
    assert exact["valid"], exact["reason"]
    assert exact["nees"] < CHI2_10_999
    assert exact["sigma"]["target"]["mass_kg"] < outcome["sigma"]["target"]["mass_kg"]


def test_a_device_with_another_sign_is_never_a_valid_result(tmp_path):
    _, recorded = flown(tmp_path, 5, "devices.yaml")
    assert recorded.final.reason == "MODEL_MISMATCH"
    assert not any(estimate.valid for estimate in recorded.estimates)
