"""A flight from bytes with late torques, and one with wrong group delays: refused without states.

With states the delays are found, and the body's covariance is honest and hardly wider.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.__main__ import main
from fsw.config import Config, load
from fsw.config.overlay_file import with_overlays
from fsw.messages import Estimate
from hil.run.bench import prepare, run_virtual
from offline.replay import replay
from tests.support.estimator_cases import TARGET, parameters
from tests.support.short_cases import NoMeter, short

SEED, POINTS = 3, 20
EVERY_S, MORE_S = 0.003, 0.010  # of every torque, and of joint 2's in addition
SIGMA_S = 0.01
SIGMAS = 3.0


def flown(folder: Path, *delays_s: float) -> Path:
    scenario = short(folder, points=POINTS)
    joints = scenario.sensors["joints"]
    nodes = [
        node | {"torque_delay_s": delay_s}
        for node, delay_s in zip(joints["nodes"], delays_s, strict=True)
    ]
    sensors = scenario.sensors | {"joints": joints | {"nodes": nodes}}
    run_virtual(prepare(replace(scenario, sensors=sensors), SEED, folder), NoMeter(), record=True)
    return folder


@pytest.fixture(scope="module")
def prompt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown(tmp_path_factory.mktemp("prompt"), *[0.0] * 7)


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> Path:
    delays_s = [EVERY_S + MORE_S * (k == 1) for k in range(7)]
    return flown(tmp_path_factory.mktemp("late"), *delays_s)


@pytest.fixture(scope="module")
def without(prompt: Path) -> Estimate:
    """The estimate of the flight without delays or states of them."""
    return estimated(prompt, load(prompt / "flight.yaml"))


def estimated(folder: Path, config: Config) -> Estimate:
    found = replay(folder / "recording.mcap", config).estimate
    assert found is not None
    return found


def with_torque_delays(folder: Path) -> Config:
    config = load(folder / "flight.yaml")
    joints = [j.model_dump() | {"torque_delay_sigma_s": SIGMA_S} for j in config.joints]
    return config.with_sections(joints=joints)


def is_honest(found: Estimate, without: Estimate) -> bool:
    """Return whether NEES and mass are in their bands, and the mass's sigma has not grown."""
    error, P = found.mean[:10] - parameters(TARGET), found.covariance[:10, :10]
    nees = float(error @ np.linalg.solve(P, error))
    growth = float(np.sqrt(P[0, 0] / without.covariance[0, 0]))
    is_in_band = chi2.ppf(0.0005, 10) < nees < chi2.ppf(0.9995, 10)
    return is_in_band and abs(error[0]) < SIGMAS * P[0, 0] ** 0.5 and growth <= 1.1


def delays(found: Estimate, group: str) -> tuple[np.ndarray, np.ndarray]:
    own = [k for k, name in enumerate(found.names) if name.startswith(group)]
    return found.mean[own], np.sqrt(np.diag(found.covariance)[own])


def test_late_torques_without_states_are_refused(late: Path) -> None:
    found = estimated(late, load(late / "flight.yaml"))
    assert not found.valid
    assert "MODEL_MISMATCH" in found.reasons


def test_late_torques_are_found(late: Path, without: Estimate) -> None:
    found = estimated(late, with_torque_delays(late))
    assert found.valid, found.reason
    true_s = EVERY_S + MORE_S * (np.arange(7) == 1)
    value, sigma = delays(found, "torque_delay")
    assert (np.abs(value - true_s) < SIGMAS * sigma).all()
    assert (sigma < 0.05 * SIGMA_S).all()
    assert is_honest(found, without)


def test_calibrate_finds_late_torques_and_its_overlay_takes_them_off(
    late: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, config = tmp_path / "calibration.yaml", late / "flight.yaml"
    words = [str(late / "recording.mcap"), "--config", str(config), "--out", str(out), "--json"]
    assert main(["calibrate", "motion", *words]) == 0
    result = json.loads(capsys.readouterr().out)
    figures = {figure["name"]: figure for figure in result["figures"]}
    overlay = {joint["name"]: joint for joint in result["overlay"]["joints"]}
    for k in range(7):
        figure, true_s = figures[f"torque_delay.joint{k + 1}"], EVERY_S + MORE_S * (k == 1)
        assert abs(figure["value"] - true_s) < SIGMAS * figure["sigma"]
        own = overlay[f"joint{k + 1}"]
        assert own["torque_delay_s"] == figure["value"]
        assert own["torque_delay_sigma_s"] == figure["sigma"] < 0.05 * SIGMA_S
    found = estimated(late, with_overlays(load(config), [out]))
    assert found.valid, found.reason  # no honest sigma: the data count twice
    error_kg = float(found.mean[0] - parameters(TARGET)[0])
    assert abs(error_kg) < SIGMAS * found.covariance[0, 0] ** 0.5


def test_states_of_delays_that_are_none_cost_little(prompt: Path, without: Estimate) -> None:
    found = estimated(prompt, with_torque_delays(prompt))
    assert found.valid, found.reason
    value, sigma = delays(found, "torque_delay")
    assert (np.abs(value) < SIGMAS * sigma).all()
    assert is_honest(found, without)


@pytest.mark.parametrize("key", ["none", "imu", "buses"])
def test_a_unit_whose_group_delays_are_wrong(prompt: Path, without: Estimate, key: str) -> None:
    """The configuration takes off 10 ms too much: the unit is early, or the bus is late."""
    config = load(prompt / "flight.yaml")
    changes: dict[str, Any] = {
        name: getattr(config.imu, name) + 0.01
        for name in ("gyro_group_delay_s", "acc_group_delay_s")
    }
    buses = [
        bus.model_dump() | {"delay_sigma_s": SIGMA_S * (key == "buses")} for bus in config.buses
    ]
    imu = config.imu.model_dump() | changes | {"delay_sigma_s": SIGMA_S * (key == "imu")}
    found = estimated(prompt, config.with_sections(imu=imu, buses=buses))
    assert found.valid == (key != "none"), found.reason
    if key != "none":
        value, sigma = delays(found, "imu_delay" if key == "imu" else "bus_delay")
        true_s = -0.01 if key == "imu" else 0.01
        assert (np.abs(value - true_s) < SIGMAS * sigma).all()
        assert sigma[0] < 0.05 * SIGMA_S
        assert is_honest(found, without)
