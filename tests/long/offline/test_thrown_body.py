"""A thrown body with a reaction wheel and no joint: imported from CSV, identified, replayed.

Bounds, set before the first run: without noise the inertia is found within 0.1 % of its mean
moment, the centre of mass within 0.05 mm and the gyro's matrix within 5e-4; with noise the mean of
the normalised error squared over 24 throws is within its 99.9 % band.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.stats import chi2

from fsw.__main__ import main
from tests.support import thrown_body
from tests.support.sampled_cases import write_csv
from tests.support.thrown_body import (
    COM_M,
    EXACT,
    INERTIA,
    Noise,
    inertia_vector,
    throw,
    write_config,
)

NOISY = Noise(rate_rad_s=5e-3, force_m_s2=0.2, speed_rad_s=2.0)
QUIET = Noise(rate_rad_s=5e-4, force_m_s2=0.02, speed_rad_s=0.2)
THROWS = 24


def imported(
    folder: Path,
    config: Path,
    seed: int,
    noise: Noise,
    late_s: float = 0.0,
    gyro_matrix: np.ndarray = EXACT,
) -> Path:
    columns = throw(noise, seed, late_s, gyro_matrix)
    table = write_csv(folder / f"throw{seed}.csv", columns)
    out = folder / f"throw{seed}.mcap"
    mapping = ["--map", str(folder / "mapping.yaml")]
    assert main(["import", str(table), *mapping, "--config", str(config), "--out", str(out)]) == 0
    return out


def leaning(scale: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return the matrix of a gyro whose axes xy, xz, yz lean to one another."""
    (x, y, z), (xy, xz, yz) = 1.0 + scale, axes
    return np.array([[x, xy, xz], [xy, y, yz], [xz, yz, z]])


def identified(recording: Path, config: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    capsys.readouterr()
    arguments = ["identify", str(recording), "--config", str(config), "--json"]
    main([*arguments, "--method", "mrnea"])
    values: dict[str, Any] = json.loads(capsys.readouterr().out)
    return values


def test_the_inertia_is_found_without_noise(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_config(tmp_path, Noise())
    own = identified(imported(tmp_path, config, 0, Noise()), config, capsys)["estimate"]["base"]
    mean = np.trace(INERTIA) / 3.0
    np.testing.assert_allclose(own["inertia_kg_m2"], inertia_vector(), rtol=0, atol=1e-3 * mean)
    np.testing.assert_allclose(own["com_m"], COM_M, rtol=0, atol=5e-5)


def test_a_motor_that_is_switched_leaves_the_inertia_right(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Within 0.5 % of the mean moment, though no polynomial follows so fast a rise."""
    monkeypatch.setattr(thrown_body, "RAMP_S", 4e-3)
    config = write_config(tmp_path, QUIET)
    found = identified(imported(tmp_path, config, 0, QUIET), config, capsys)
    off = np.subtract(found["estimate"]["base"]["inertia_kg_m2"], inertia_vector())
    assert np.abs(off).max() < 5e-3 * np.trace(INERTIA) / 3.0


def test_the_wheels_delay_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Sought, it leaves less than a fifth of the error that it makes when it is not."""
    recording = imported(tmp_path, write_config(tmp_path, Noise()), 0, Noise(), 1.5e-3)
    errors = []
    for delay_sigma_s in (0.0, 5e-3):
        config = write_config(tmp_path, Noise(), delay_sigma_s)
        own = identified(recording, config, capsys)["estimate"]["base"]["inertia_kg_m2"]
        errors.append(float(np.abs(own - inertia_vector()).max()))
    assert errors[1] < 0.2 * errors[0]


def test_sigma_covers_the_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Six inertias and three places of the centre of mass, each by its own sigma."""
    config, squares = write_config(tmp_path, NOISY), []
    for seed in range(THROWS):
        found = identified(imported(tmp_path, config, seed, NOISY), config, capsys)
        assert found["status"] == "OK", (seed, found["note"])
        own, sigma = found["estimate"]["base"], found["sigma"]["base"]
        error = np.subtract(own["inertia_kg_m2"], inertia_vector())
        error = np.concatenate([error, np.subtract(own["com_m"], COM_M)])
        squares.append(error / np.concatenate([sigma["inertia_kg_m2"], sigma["com_m"]]))
    mean = float(np.mean(np.square(squares)))
    low, high = chi2.ppf([0.0005, 0.9995], THROWS) / THROWS  # as if all nine were one
    assert low < mean < high


def test_errors_of_the_gyros_axes_are_found_and_declared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a calibration finds undoes the errors, and the next throw is as one without any."""
    scale, axes = 5e-3 * np.array([1.0, -0.6, 0.8]), 0.01 * np.array([1.0, -0.7, 0.5])
    true = leaning(scale, axes)
    sought = {"gyro_scale_sigma_ratio": 0.01, "gyro_axes_sigma_rad": 0.02}
    config = write_config(tmp_path, QUIET, imu=sought)
    recordings = [
        str(imported(tmp_path, config, seed, QUIET, gyro_matrix=true)) for seed in range(3)
    ]
    overlay = tmp_path / "overlay.yaml"
    arguments = ["calibrate", "motion", *recordings, "--config", str(config)]
    assert main([*arguments, "--out", str(overlay)]) == 0
    declared = yaml.safe_load(overlay.read_text())["imu"]
    np.testing.assert_allclose(declared["gyro_matrix"], true, rtol=0, atol=5e-4)
    assert declared["gyro_scale_sigma_ratio"] < 1e-3
    assert declared["gyro_axes_sigma_rad"] < 2e-3
    errors = []
    for seed, imu in ((8, {}), (9, {"gyro_matrix": declared["gyro_matrix"]})):
        config = write_config(tmp_path, Noise(), imu=imu)
        recording = imported(tmp_path, config, seed, Noise(), gyro_matrix=true)
        own = identified(recording, config, capsys)["estimate"]["base"]["inertia_kg_m2"]
        errors.append(float(np.abs(own - inertia_vector()).max()))
    assert errors[1] < 0.1 * errors[0]


def test_sigma_covers_what_the_gyros_axes_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Scales and axes drawn from their priors, the six inertias by their covariance."""
    scale_sigma, axes_sigma, rng, squares = 5e-3, 0.01, np.random.default_rng(18), []
    sought = {"gyro_scale_sigma_ratio": scale_sigma, "gyro_axes_sigma_rad": axes_sigma}
    config = write_config(tmp_path, NOISY, imu=sought)
    for seed in range(THROWS):
        true = leaning(rng.normal(0.0, scale_sigma, 3), rng.normal(0.0, axes_sigma, 3))
        recording = imported(tmp_path, config, seed, NOISY, gyro_matrix=true)
        found = identified(recording, config, capsys)
        assert found["status"] == "OK", (seed, found["note"])
        own, sigma = found["estimate"]["base"], found["sigma"]["base"]["inertia_kg_m2"]
        squares.append(np.subtract(own["inertia_kg_m2"], inertia_vector()) / sigma)
    mean = float(np.mean(np.square(squares)))
    low, high = chi2.ppf([0.0005, 0.9995], THROWS) / THROWS  # as if all six were one
    assert low < mean < high


def test_several_recordings_are_for_bodies_without_joints_in_motion(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_config(tmp_path, Noise())
    recording = str(imported(tmp_path, config, 0, Noise()))
    capsys.readouterr()
    assert main(["calibrate", "rest", recording, recording, "--config", str(config)]) != 0
    assert "several recordings make one calibration only of" in capsys.readouterr().err


def test_the_recursion_of_a_replay_finds_it_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_config(tmp_path, NOISY)
    # over 40 ms, the batch's window, the rise of the rate is no polynomial: a change of the body
    config.write_text(config.read_text().replace("window_s: 0.04", "window_s: 0.03"))
    recording = imported(tmp_path, config, 1, NOISY)
    capsys.readouterr()
    assert main(["replay", str(recording), "--config", str(config), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["valid"], values["reason"]
    own, sigma = values["estimate"]["base"], values["sigma"]["base"]
    off = np.subtract(own["inertia_kg_m2"], inertia_vector()) / sigma["inertia_kg_m2"]
    assert np.all(np.abs(off) < 5.0)


@pytest.mark.parametrize("method", ["fused", "rda", "cm", "ce"])
def test_other_methods_say_in_a_line_that_they_need_joints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str
) -> None:
    config = write_config(tmp_path, Noise())
    recording = imported(tmp_path, config, 0, Noise())
    capsys.readouterr()
    arguments = ["identify", str(recording), "--config", str(config), "--method", method]
    assert main(arguments) != 0
    said = capsys.readouterr().err
    assert "needs joints" in said
    assert "Traceback" not in said
