"""`hil study modes`: the Cramer-Rao bound of a scenario with panels or liquid, modes included.

The raw sensors have white noise at their native rates, as in `judge/bound.py`. Central differences
of MuJoCo simulations give the derivatives by bodies and modes. The bound is slightly too low: it
assumes exact encoders, and modes that are known to rest at the start. Torque offsets, biases and
each mode's mass, frequency and damping are states too, with the flight configuration's priors.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from evidence.methods.exact import true_robot
from evidence.store import JOURNAL
from evidence.terminal import print_table
from hil.judge.bound import Sensors
from hil.run.flight_sensors import bound_sensors
from hil.world.inertia import COUNT, FloatArray
from hil.world.scenario import Scenario, ScenarioError, load
from hil.world.spline import JointSpline
from hil.world.springs import Panel, SloshMass
from hil.world.truth import simulate

RATE_HZ = 10.0  # rate of the simulated samples; weights raise it to the rate of each sensor
STEP_S = 0.01  # step of the integration
STEPS = (1.0, *[1e-3] * 3, *[1.0] * 6)  # of mass [kg], centre of mass [m], inertia [kg m2]
NAMES = ("m", "cx", "cy", "cz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
MODE_STEP = 0.02  # relative step of a modal mass; step of ln(frequency) and ln(damping)


def information(scenario: Scenario) -> FloatArray:
    """Return the information (p, p) of the samples and of all priors except those of the bodies.

    p: ten values of each unknown body, then mass, frequency and damping of each mode.

    Raises
    ------
    ScenarioError if the scenario has no panels or liquid, or does not declare their modes.
    """
    told = scenario.flight.get("modes")
    if not told or not (scenario.slosh or scenario.panels):
        raise ScenarioError("hil study modes: the scenario must have panels or liquid, declared")
    spline = JointSpline.load(scenario.identification)
    sensors = bound_sensors(scenario, spline.n)
    pairs = list(_pairs(scenario))
    columns = [
        (_samples(more, spline, sensors) - _samples(less, spline, sensors)) / (2.0 * step)
        for more, less, step in track(pairs, "derivatives", console=Console(stderr=True))
    ]
    J = np.stack(columns, axis=2)  # (N, n + 6, p)
    inertial = np.repeat([sensors.acc_noise_m_s2, sensors.gyro_noise_rad_s], 3)
    rates = np.r_[[sensors.joint_rate_hz] * spline.n, [sensors.imu_rate_hz] * 6] / RATE_HZ
    weight = rates / np.r_[sensors.torque_noise_nm, inertial] ** 2
    biases = np.repeat([sensors.acc_bias_sigma_m_s2, sensors.gyro_bias_sigma_rad_s], 3)
    offset = np.r_[sensors.torque_offset_sigma_nm, biases]
    total = np.einsum("kip,i,kiq->pq", J, weight, J)
    cross = J.sum(axis=0).T * weight  # information shared with the offset of each channel
    total -= (cross / (len(J) * weight + 1.0 / offset**2)) @ cross.T
    kinds = ("mass_sigma_ratio", "frequency_sigma_ratio", "damping_sigma_ratio")
    modes = len(scenario.slosh) + len(scenario.panels)
    sigma = np.tile([float(told[kind]) for kind in kinds], modes)
    own = np.arange(len(total) - len(sigma), len(total))
    total[own, own] += 1.0 / sigma**2
    return np.asarray(total)


def _pairs(scenario: Scenario) -> Iterator[tuple[Scenario, Scenario, float]]:
    """Yield two scenarios, with one value of a body or mode a step up and down, and the step."""
    for body in scenario.unknown:
        for k, step in enumerate(STEPS):
            both = [scenario.truth[body] + sign * step * np.eye(COUNT)[k] for sign in (1, -1)]
            more, less = (replace(scenario, truth={**scenario.truth, body: r}) for r in both)
            yield more, less, step
    for place in ("slosh", "panels"):
        parts: tuple[SloshMass | Panel, ...] = getattr(scenario, place)
        for i, part in enumerate(parts):
            for change in (_heavier, _faster, _more_damped):
                both = [(*parts[:i], change(part, e), *parts[i + 1 :]) for e in (1, -1)]
                more, less = (replace(scenario, **{place: changed}) for changed in both)
                yield more, less, MODE_STEP


def _heavier(part: SloshMass | Panel, sign: int) -> SloshMass | Panel:
    factor = 1.0 + sign * MODE_STEP
    if isinstance(part, SloshMass):
        return replace(part, mass_kg=factor * part.mass_kg)
    xx, xy, xz, yy, yz, zz = (factor * value for value in part.inertia_kg_m2)
    return replace(part, mass_kg=factor * part.mass_kg, inertia_kg_m2=(xx, xy, xz, yy, yz, zz))


def _faster(part: SloshMass | Panel, sign: int) -> SloshMass | Panel:
    return replace(part, frequency_hz=part.frequency_hz * float(np.exp(sign * MODE_STEP)))


def _more_damped(part: SloshMass | Panel, sign: int) -> SloshMass | Panel:
    return replace(part, damping_ratio=part.damping_ratio * float(np.exp(sign * MODE_STEP)))


def _samples(scenario: Scenario, spline: JointSpline, sensors: Sensors) -> FloatArray:
    """Return torques [N m], specific force [m/s2] in S and rate [rad/s] in S, (N, n + 6)."""
    end_s = spline.duration_s + scenario.after_s
    history = simulate(true_robot(scenario), spline, -scenario.before_s, end_s, STEP_S)
    count = int((end_s + scenario.before_s) * RATE_HZ)
    s = history.at(-scenario.before_s + np.arange(count) / RATE_HZ)
    r, w = sensors.p_BS_m, s.w_NB_B
    f = s.a_NB_B + np.cross(s.wd_NB_B, r) + np.cross(w, np.cross(w, r))
    return np.concatenate([s.tau, f @ sensors.R_BS, w @ sensors.R_BS], axis=1)


def ratios(scenario: Scenario, outcomes: list[Mapping[str, Any]]) -> dict[str, FloatArray]:
    """Return for each unknown body the rms over the runs of sigma over its bound, (10,).

    The bound of a run includes the information of this run's priors of the bodies.
    """
    data = information(scenario)
    found: dict[str, list[FloatArray]] = {body: [] for body in scenario.unknown}
    for outcome in outcomes:
        total = data.copy()
        for k, body in enumerate(scenario.unknown):
            own = np.arange(COUNT * k, COUNT * (k + 1))
            total[own, own] += 1.0 / _ten(outcome["prior"][body]["sigma"]) ** 2
        scale = 1.0 / np.sqrt(np.diag(total))
        inverse = np.linalg.solve(total * np.outer(scale, scale), np.eye(len(scale)))
        least = np.sqrt(np.diag(inverse)) * scale
        for k, body in enumerate(scenario.unknown):
            bound = least[COUNT * k : COUNT * (k + 1)]
            found[body].append(_ten(outcome["sigma"][body]) / bound)
    return {body: np.sqrt(np.mean(np.square(each), axis=0)) for body, each in found.items()}


def study(scenario: str, runs: Path) -> int:
    """Print sigma over bound of the valid runs of `hil seeds SCENARIO --out RUNS`; return 0.

    Raises
    ------
    ScenarioError if there are no valid runs, or if the scenario declares no modes.
    """
    try:
        lines = (runs / JOURNAL).read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ScenarioError(f"--runs {runs}: {error}") from error
    rows = [json.loads(line)[1] for line in lines]
    valid = [row for row in rows if row["scenario"] == scenario and row["valid"]]
    if not valid:
        raise ScenarioError(f"--runs {runs}: no valid run of {scenario}")
    print_table(
        f"{scenario}: sigma over its bound, modes included; {len(valid)} valid runs",
        ("body", *NAMES),
        [
            [body, *(f"{value:.2f}" for value in ratio)]
            for body, ratio in ratios(load(scenario), valid).items()
        ],
        100,
    )
    return 0


def _ten(values: Mapping[str, Any]) -> FloatArray:
    return np.array([values["mass_kg"], *values["com_m"], *values["inertia_kg_m2"]])
