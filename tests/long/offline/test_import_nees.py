"""Irregular samples at 30 Hz, imported: the covariance of the estimate is honest.

Bound, set before the first run: over ten seeds the mean normalised error squared of a target lies
in its 95 % band.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.special import chdtri

from fsw.__main__ import main
from hil.run.bench import prepare
from hil.world.inertia import pi_of
from hil.world.scenario import load
from tests.support.sampled_cases import sampled, sampled_config, write_csv

SEEDS = range(300, 310)
MAPPING = {
    "time": {"column": "t", "unit": "s"},
    "joints": {
        "file": "joints.csv",
        "position": {"columns": "q_{}", "unit": "rad"},
        "torque": {"columns": "tau_{}", "unit": "N m"},
    },
    "imu": {
        "file": "imu.csv",
        "rate": {"columns": "w{}", "unit": "rad/s"},
        "specific_force": {"columns": "f{}", "unit": "m/s2"},
    },
}


def error_squared(folder: Path, seed: int, capsys: pytest.CaptureFixture[str]) -> float:
    setup = prepare(load("bench_target"), seed, folder)
    config = sampled_config(setup)
    joints, inertial = sampled(setup, config, seed)
    write_csv(folder / "joints.csv", joints)
    write_csv(folder / "imu.csv", inertial)
    (folder / "map.yaml").write_text(yaml.safe_dump(MAPPING))
    shared = ["--config", str(config)]
    out = str(folder / "out.mcap")
    assert main(["import", "--map", str(folder / "map.yaml"), *shared, "--out", out]) == 0
    capsys.readouterr()
    main(["identify", out, *shared, "--json"])
    found = json.loads(capsys.readouterr().out)
    e = np.array(found["mean"])[:10] - pi_of(setup.scenario.truth["target"])
    return float(e @ np.linalg.solve(np.array(found["covariance"])[:10, :10], e))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_irregular_samples_at_30_hz_are_identified_with_an_honest_covariance(tmp_path, capsys):
    errors = []
    for seed in SEEDS:
        (tmp_path / str(seed)).mkdir()
        errors.append(error_squared(tmp_path / str(seed), seed, capsys))
    dof = 10 * len(SEEDS)
    low, high = chdtri(dof, 0.975) / len(SEEDS), chdtri(dof, 0.025) / len(SEEDS)
    assert low < np.mean(errors) < high, errors
