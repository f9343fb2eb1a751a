"""A robot of which every sensor is on one CAN bus and known by its description alone.

A free-floating motion of the bench's truth; cantools encodes unit and tracker, struct the joints.
"""

from pathlib import Path
from typing import Any

import cantools
import numpy as np
import yaml
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from fsw.__main__ import main
from fsw.config import load
from hil.run.bench import Setup, prepare
from hil.world.inertia import pi_of
from hil.world.sensors import angular_rate, rotation_of, specific_force
from offline.identify import identify
from tests.support.short_cases import short
from tests.support.wired_cases import candump, described

WIRE_S, LATE_S = 1.4e-4, 2e-5
EPOCH_S = 1_760_000_000
SEEDS = (1, 2, 3)
DBC = """VERSION ""
NS_ :
BS_:
BU_: A

BO_ 768 Gyro: 8 A
 SG_ X : 0|21@1- (0.0001,0) [0|0] "deg/s" A
 SG_ Y : 21|21@1- (0.0001,0) [0|0] "deg/s" A
 SG_ Z : 42|21@1- (0.0001,0) [0|0] "deg/s" A
 SG_ Valid : 63|1@1+ (1,0) [0|0] "" A

BO_ 769 Accel: 8 A
 SG_ X : 7|21@0- (2E-06,0) [0|0] "g" A
 SG_ Y : 18|21@0- (2E-06,0) [0|0] "g" A
 SG_ Z : 45|21@0- (2E-06,0) [0|0] "g" A

BO_ 2147484416 Attitude1: 8 A
 SG_ Q0 : 0|32@1- (9.31322574615479E-10,0) [0|0] "" A
 SG_ Q1 : 32|32@1- (9.31322574615479E-10,0) [0|0] "" A

BO_ 2147484417 Attitude2: 8 A
 SG_ Q2 : 0|32@1- (9.31322574615479E-10,0) [0|0] "" A
 SG_ Q3 : 32|32@1- (9.31322574615479E-10,0) [0|0] "" A
"""
DATABASE = cantools.database.load_string(DBC, "dbc")


def line(t_s: float, name: str, values: dict[str, float]) -> tuple[float, str]:
    message = DATABASE.get_message_by_name(name)
    width = 8 if message.is_extended_frame else 3
    return t_s, f"can0 {message.frame_id:0{width}X}#{message.encode(values).hex().upper()}"


def sensed(setup: Setup, seed: int) -> list[tuple[float, str]]:
    """Return the frames of inertial unit and star tracker with their stamps [s]."""
    rng, imu, tracker = (
        np.random.default_rng([seed, 7]),
        setup.config.imu,
        setup.config.star_tracker,
    )
    assert tracker is not None
    R_BS = rotation_of(imu.mounting.q_BS_xyzw)
    sent, end_s = [], setup.history.end_s
    t_s = np.arange(rng.uniform(0.0, 1.0) / imu.rate_hz, end_s, 1.0 / imu.rate_hz)
    at = [
        setup.history.at(np.maximum(t_s - delay_s, 0.0))
        for delay_s in (imu.gyro_group_delay_s, imu.acc_group_delay_s)
    ]
    root = np.sqrt(imu.rate_hz)
    rates = angular_rate(at[0], R_BS) + rng.normal(0, imu.gyro_bias_sigma_rad_s, 3)
    rates = rates + rng.normal(0, imu.angle_random_walk_rad_sqrt_s * root, rates.shape)
    forces = specific_force(at[1], imu.mounting.p_BS_m, R_BS)
    forces = forces + rng.normal(0, imu.acc_bias_sigma_m_s2, 3)
    forces = forces + rng.normal(0, imu.velocity_random_walk_m_s_sqrt_s * root, forces.shape)
    stamps_s = t_s + WIRE_S + rng.exponential(LATE_S, len(t_s))
    for stamp_s, w, f in zip(stamps_s, np.degrees(rates), forces / 9.80665, strict=True):
        sent.append(line(stamp_s, "Gyro", dict(zip("XYZ", w, strict=True)) | {"Valid": 1}))
        sent.append(line(stamp_s + 2e-4, "Accel", dict(zip("XYZ", f, strict=True))))
    t_s = np.arange(rng.uniform(0.0, 1.0) / tracker.rate_hz, end_s, 1.0 / tracker.rate_hz)
    state = setup.history.at(np.maximum(t_s - tracker.latency_s, 0.0))
    noise = rng.normal(size=(len(t_s), 3))
    noise *= [tracker.noise_across_rad, tracker.noise_across_rad, tracker.noise_about_rad]
    own = Rotation.from_matrix(state.R_NB @ rotation_of(tracker.mounting.q_BS_xyzw))
    shown = (own * Rotation.from_rotvec(noise)).inv()  # inertial to tracker
    stamps_s = t_s + WIRE_S + rng.exponential(LATE_S, len(t_s))
    for stamp_s, q in zip(stamps_s, shown.as_quat(), strict=True):
        w, x, y, z = np.roll(q, 1) * (1 - 1e-9)
        sent.append(line(stamp_s, "Attitude1", {"Q0": w, "Q1": x}))
        sent.append(line(stamp_s + 2e-4, "Attitude2", {"Q2": y, "Q3": z}))
    return sent


def robot(setup: Setup, folder: Path) -> Path:
    """Write the configuration that reads such frames."""
    data: dict[str, Any] = described(setup, clamped=False)
    (folder / "robot.dbc").write_text(DBC)
    data["buses"][0]["description"] = "robot.dbc"
    timing = {"by": "arrival", "sigma_s": LATE_S}
    axes = {
        f"{role}_{axis}": {"message": message, "signal": axis.upper()}
        for role, message in (("rate", "Gyro"), ("force", "Accel"))
        for axis in "xyz"
    }
    axes["status"] = {"message": "Gyro", "signal": "Valid", "mask": 1, "value": 1}
    q = {
        f"q_{name}": {"message": f"Attitude{1 + k // 2}", "signal": f"Q{k}"}
        for k, name in enumerate("wxyz")
    }
    for section, signals in (("imu", axes), ("star_tracker", q)):
        data[section].pop("port")
        data[section].pop("options", None)
        data[section] |= {"driver": "described", "bus": "arm", "signals": signals, "timing": timing}
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def flown(seed: int, folder: Path) -> tuple[dict[str, Any], float]:
    """Return what is identified from a log of the motion, and the target's squared error."""
    setup = prepare(short(folder, hurry=2.0), seed, folder)
    path, log = robot(setup, folder), candump(setup, folder / "candump.log", seed=seed)
    lines = [own.split(") ", 1) for own in log.read_text().splitlines()]
    sent = [(float(t[1:]) - EPOCH_S, frame) for t, frame in lines] + sensed(setup, seed)
    log.write_text("".join(f"({EPOCH_S + t:.6f}) {frame}\n" for t, frame in sorted(sent)))
    recording = folder / "recording.mcap"
    words = ["import", "--can", f"arm={log}", "--config", str(path), "--out", str(recording)]
    assert main(words) == 0
    found = identify(recording, load(path), "fused", ("target",))
    ten = [k for k, name in enumerate(found["names"]) if name.startswith("target.")]
    error = np.array(found["mean"])[ten] - pi_of(setup.scenario.truth["target"])
    P = np.array(found["covariance"])[np.ix_(ten, ten)]
    return found, float(error @ np.linalg.solve(P, error))


def test_the_target_is_found_in_band(tmp_path, capsys):
    errors = []
    for seed in SEEDS:
        (folder := tmp_path / str(seed)).mkdir()
        found, error = flown(seed, folder)
        errors.append(error)
        assert (found["status"], found["reasons"]) == ("OK", [])
        for name in ("imu", "star_tracker"):
            counts = found["samples"][name]
            assert (counts["accepted"] > 50, counts["lost"], counts["rejected"]) == (True, 0, 0)
    low, high = chi2.ppf([0.005, 0.995], 10 * len(SEEDS))
    assert low < sum(errors) < high, errors
    said = capsys.readouterr().out
    assert "imu: " in said
    assert "rate_x Gyro.X (0x300) 21 bits signed" in said
    assert "not described" not in said


def test_the_configuration_is_checked_and_described(tmp_path, capsys):
    setup = prepare(short(tmp_path, hurry=2.0), 1, tmp_path)
    path = robot(setup, tmp_path)
    assert main(["check", str(path)]) == 0
    said = capsys.readouterr().out
    assert "q_w Attitude1.Q0 (0x300) 32 bits signed" in said
    assert "imu: described on arm, 125 Hz" in said
    path.write_text(path.read_text().replace("signal: Q3", "signal: Q4"))
    assert main(["check", str(path)]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert "star_tracker.signals.q_z.signal: 'Q4' is not in Attitude2; 'Q2, Q3' are" in said
