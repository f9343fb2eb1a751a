"""A clamped arm with friction by load and angle that its naive configuration does not declare.

Torques are inverse dynamics of Pinocchio, with friction and ripple that no state of the model has.
"""

import json
import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from fsw.__main__ import main

URDF = Path(__file__).parents[3] / "hil" / "robots" / "panda.urdf"
RATE_HZ, DURATION_S = 100.0, 40.0
COM_M, INERTIA_KG_M2 = np.array([0.01, -0.01, 0.06]), np.diag([0.003, 0.003, 0.002])
MAPPING = {
    "time": {"column": "t_s", "unit": "s"},
    "joints": {
        "position": {"columns": "q_{}", "unit": "rad"},
        "torque": {"columns": "tau_{}", "unit": "N m"},
    },
}


def motion(rng: np.random.Generator, arm: pin.Model) -> tuple[np.ndarray, ...]:
    """Return times, angles, rates and accelerations of five harmonics per joint."""
    t = np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)
    rates = 2.0 * np.pi * np.array([0.05, 0.1, 0.15, 0.25, 0.3])
    size = rng.normal(size=(arm.nq, 5)) / np.sqrt(rates / rates[0])
    span = 0.35 * (arm.upperPositionLimit - arm.lowerPositionLimit)
    size *= (span / np.abs(size).sum(axis=1))[:, None]
    phase = rates * t[:, None, None] + rng.uniform(0.0, 2.0 * np.pi, size.shape)
    middle = 0.5 * (arm.upperPositionLimit + arm.lowerPositionLimit)
    waves = (np.sin(phase), rates * np.cos(phase), -(rates**2) * np.sin(phase))
    q, qd, qdd = ((size * wave).sum(axis=2) for wave in waves)
    return t, middle + q, qd, qdd


def loaded(arm: pin.Model, mass_kg: float) -> pin.Model:
    """Return the arm, which holds a payload from now on."""
    if mass_kg:
        flange = arm.frames[arm.getFrameId("flange")]
        payload = pin.Inertia(mass_kg, COM_M, INERTIA_KG_M2)
        arm.appendBodyToJoint(flange.parentJoint, payload, flange.placement)
    return arm


def table(seed: int, mass_kg: float) -> np.ndarray:
    """Return times, measured angles and measured torques; friction is 3 % of the torques."""
    rng, arm = np.random.default_rng(seed), pin.buildModelFromUrdf(str(URDF))
    t, q, qd, qdd = motion(rng, loaded(arm, mass_kg))
    data, n = arm.createData(), arm.nq
    tau = np.array([pin.rnea(arm, data, *one) for one in zip(q, qd, qdd, strict=True)])
    dry = 0.1 * np.exp(0.5 * rng.normal(size=n)) + 0.01 * np.abs(tau)
    ripple = 0.05 * np.sin(20.0 * q + rng.uniform(0.0, 2.0 * np.pi, n))
    offset = 0.002 * arm.effortLimit * rng.normal(size=n)
    tau = tau + dry * np.tanh(qd / 0.02) + 0.05 * qd + ripple + offset
    tau += 0.05 * rng.normal(size=tau.shape)
    return np.column_stack([t, q + 2e-5 * rng.normal(size=q.shape), tau])


def configured(folder: Path, sensor: str) -> Path:
    """Return the configuration that `fsw init` writes for an owner of the arm."""
    config = folder / "r.yaml"
    (folder / "map.yaml").write_text(yaml.safe_dump(MAPPING), encoding="utf-8")
    naive = ("--base", "clamped", "--imu", "none", "--tracker", "none", "--rate-hz", "100")
    grasped = ("--tool", "flange", "--unknown", "target", "--target-mass-kg", "1")
    flags = [*grasped, *naive, "--torque", sensor]
    assert main(["init", str(URDF), "--out", str(config), *flags]) == 0
    text = re.sub(r"interface: \w+", "interface: samples", config.read_text(encoding="utf-8"))
    config.write_text(text, encoding="utf-8")
    return config


def recorded(config: Path, rows: np.ndarray, name: str) -> Path:
    motion_csv, recording = config.with_name(f"{name}.csv"), config.with_name(f"{name}.mcap")
    names = [f"{kind}_joint{k}" for kind in ("q", "tau") for k in range(1, 8)]
    head = ",".join(["t_s", *names])
    np.savetxt(motion_csv, rows, "%.9g", delimiter=",", header=head, comments="")
    mapping = str(config.with_name("map.yaml"))
    told = ["--map", mapping, "--config", str(config), "--out", str(recording)]
    assert main(["import", str(motion_csv), *told]) == 0
    return recording


def identified(capsys, config: Path, recording: Path, *more: str) -> dict:
    capsys.readouterr()
    main(["identify", str(recording), "--config", str(config), "--json", *more])
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("sensor", ["generic", "arm_sensor"])
@pytest.mark.parametrize("mass_kg", [1.4, 0.0])
def test_the_mass_is_of_use_and_honest(mass_kg: float, sensor: str, tmp_path: Path, capsys) -> None:
    """`generic` declares no friction at all: only the likeness of the residuals shows it."""
    config = configured(tmp_path, sensor)
    found = identified(capsys, config, recorded(config, table(0, mass_kg), "arm"))
    assert set(found["reasons"]) <= {"INSUFFICIENT_EXCITATION"}, found["note"]
    mass, sigma = found["estimate"]["target"]["mass_kg"], found["sigma"]["target"]["mass_kg"]
    assert abs(mass - mass_kg) < 3.0 * sigma
    assert sigma < 0.25  # half of the prior's
    if sensor == "generic":
        assert "alike from window to window" in found["note"]
    if mass_kg:
        assert found["diagnosis"]["parameters"]["target"]["mass_kg"] == "measured"


def currents(seed: int, mass_kg: float) -> np.ndarray:
    """Return times, angles and torques by motor current, which are 17 % too small.

    The links are 15 % heavier than those of the URDF, and the gears have friction by their load.
    """
    rng, arm = np.random.default_rng(seed), pin.buildModelFromUrdf(str(URDF))
    for k, link in enumerate(arm.inertias):
        arm.inertias[k] = pin.Inertia(1.15 * link.mass, link.lever, 1.15 * link.inertia)
    t, q, qd, qdd = motion(rng, loaded(arm, mass_kg))
    data, limit = arm.createData(), arm.effortLimit
    tau = np.array([pin.rnea(arm, data, *one) for one in zip(q, qd, qdd, strict=True)])
    friction = (0.05 * limit + 0.08 * np.abs(tau)) * np.tanh(qd / 0.03) + 0.03 * limit * qd
    tau = 0.83 * (tau + friction + 0.01 * limit * qdd)
    tau += 0.003 * limit * rng.normal(size=tau.shape)
    return np.column_stack([t, q + 2e-5 * rng.normal(size=q.shape), tau])


def test_a_reference_hands_on_no_more_than_currents_can_show(tmp_path: Path, capsys) -> None:
    """One scale of gains and masses is in doubt: an empty run does not show it."""
    config = configured(tmp_path, "motor_current")
    loaded = recorded(config, currents(1, 1.4), "loaded")
    empty = recorded(config, currents(2, 0.0), "empty")
    found = identified(capsys, config, loaded, "--reference", str(empty))
    assert set(found["reasons"]) <= {"INSUFFICIENT_EXCITATION"}, found["note"]
    mass, sigma = found["estimate"]["target"]["mass_kg"], found["sigma"]["target"]["mass_kg"]
    assert abs(mass - 1.4) < 3.0 * sigma
    assert 0.05 * 1.4 < sigma < 0.25  # links and gains are known to 20 % each; half of the prior's
    assert found["diagnosis"]["parameters"]["target"]["mass_kg"] == "measured"


def test_a_reference_that_is_refused_names_the_joint_and_what_to_declare(
    tmp_path: Path, capsys
) -> None:
    """The "empty" run holds 1.4 kg, and nothing is declared that may explain its torques."""
    config = configured(tmp_path, "generic")
    text = config.read_text(encoding="utf-8").replace(
        "links_sigma_ratio: 0.2", "links_sigma_ratio: 0.01"
    )
    config.write_text(text, encoding="utf-8")
    loaded = str(recorded(config, table(1, 1.4), "loaded"))
    assert main(["identify", loaded, "--config", str(config), "--reference", loaded]) == 1
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "the reference does not fit" in said
    assert re.search(r"the torque of joint\d fits worst: residuals of [\d.]+ N m", said)
    assert "torque_model_sigma_nm" in said


@pytest.mark.parametrize(("seconds", "is_enough"), [("1.7", False), ("5", True)])
def test_a_few_seconds_give_a_mass_of_use_and_every_command_says_so(
    seconds: str, is_enough: bool, tmp_path: Path, capsys
) -> None:
    """Four windows are too few, twelve are not, and sigma counts that they are few."""
    config = configured(tmp_path, "arm_sensor")
    recording = recorded(config, table(3, 1.4), "arm")
    batch = identified(capsys, config, recording, "--to", seconds)
    main(["replay", str(recording), "--config", str(config), "--json", "--to", seconds])
    recursion = json.loads(capsys.readouterr().out)
    assert batch["reasons"] == recursion["reasons"]
    assert ("TOO_FEW_BLOCKS" in batch["reasons"]) != is_enough
    assert "windows show the noise of the joints" in batch["note"]
    if is_enough:
        assert set(batch["reasons"]) <= {"INSUFFICIENT_EXCITATION"}
        for found in (batch, recursion):
            mass, sigma = (found[key]["target"]["mass_kg"] for key in ("estimate", "sigma"))
            assert abs(mass - 1.4) < 3.0 * sigma
            assert found["diagnosis"]["parameters"]["target"]["mass_kg"] == "measured"
