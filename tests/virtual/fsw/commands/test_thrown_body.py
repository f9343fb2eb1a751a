"""A thrown body with a reaction wheel and no joint: imported from CSV, identified, replayed.

Bounds, set before the first run: without noise the inertia is found within 0.1 % of its mean
moment and the centre of mass within 0.05 mm; with noise the mean of the normalised error squared
over 24 throws is within its 99.9 % band.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.__main__ import main
from tests.support.sampled_cases import write_csv
from tests.support.thrown_body import (
    COM_M,
    INERTIA,
    Noise,
    inertia_vector,
    throw,
    write_config,
)

NOISY = Noise(rate_rad_s=5e-3, force_m_s2=0.2, speed_rad_s=2.0)
THROWS = 24


def imported(folder: Path, config: Path, seed: int, noise: Noise, late_s: float = 0.0) -> Path:
    table = write_csv(folder / f"throw{seed}.csv", throw(noise, seed, late_s))
    out = folder / f"throw{seed}.mcap"
    mapping = ["--map", str(folder / "mapping.yaml")]
    assert main(["import", str(table), *mapping, "--config", str(config), "--out", str(out)]) == 0
    return out


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


def test_the_recursion_of_a_replay_finds_it_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_config(tmp_path, NOISY)
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
