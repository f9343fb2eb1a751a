"""Bias from disturbances on noise-free data, ignored or estimated, for RDA and fused.

Blocks of exact channels, with the covariances of the data sheet's noise, go through the flight
software's row functions. The prior's mean is the truth, so all errors come from the disturbances.
"""

import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from evidence.methods.flight_side import problem_of, write_config
from evidence.paper.cases import ALL, NONE, PaperUnit, exact_sensors, scenario_of, truth_of
from evidence.paper.identify import verification
from evidence.paper.samples import history_of
from fsw.estimators.batch.solver import solve
from fsw.estimators.conditioning.polynomial import NodeFit, gauss_nodes
from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from hil.run.flight_sensors import bound_sensors
from hil.world.history import TruthHistory
from hil.world.inertia import FloatArray
from hil.world.sensors import specific_force

WINDOW_S, NODES = 0.4, 4
POSITION_NOISE_RAD = 1.1e-7  # 24 bits
METHODS = ("rda", "fused")
# priors of the estimated wrenches, so wide that they have no effect on noise-free data
SIGMA_N, SIGMA_NM = 1.0, 1.0
BODIES = {"base": ("external",), "target": ("external", "target"), "both": ("external", "target")}


def wrenches(system: str) -> dict[str, float]:
    """Return the settings of wide priors for a wrench on every body of a system with surfaces."""
    kinds = {"force_sigma_n": SIGMA_N, "torque_sigma_nm": SIGMA_NM}
    return {f"{body}_{kind}": sigma for body in BODIES[system] for kind, sigma in kinds.items()}


def run_bias(unit: PaperUnit) -> dict[str, Any]:
    """Return errors by method, disturbance and treatment; and the share of the bias removed."""
    found: dict[str, Any] = {}
    for method in METHODS:
        for acting in (NONE, ALL):
            for estimated in (False, True):
                name = f"{method}, {acting}, {'estimated' if estimated else 'ignored'}"
                found[name] = _solved(unit, method, acting, estimated=estimated)
        bias = found[f"{method}, {ALL}, ignored"]["mean_position_m"]
        left = found[f"{method}, {ALL}, estimated"]["mean_position_m"]
        found[f"{method}, removed"] = 1.0 - left / bias
    return found


def _solved(unit: PaperUnit, method: str, acting: str, *, estimated: bool) -> dict[str, Any]:
    problem = _problem(unit, acting, estimated=estimated)
    rows = row_function("fused" if method == "fused" else "rda", "eiv", problem)
    truth = truth_of(scenario_of(unit.orbit, unit.system, acting))
    start = problem.prior_mean
    solution = solve(problem, rows, _blocks(unit.orbit, unit.system, acting), None, start)
    k = problem.bodies
    error = solution.mean[k] - truth
    covariance = solution.information.covariance()[k, k]
    whitened = error @ np.linalg.solve(covariance, error)
    tool = verification(unit.orbit, unit.system).error(solution.mean[k], truth).summary()
    return {
        "status": solution.status,
        "error_sigma_rms": float(np.sqrt(whitened / len(error))),
        "mass_error_ratio": [float(error[10 * i] / truth[10 * i]) for i in range(len(truth) // 10)],
        **tool,
    }


def _problem(unit: PaperUnit, acting: str, *, estimated: bool) -> Problem:
    scenario = scenario_of(unit.orbit, unit.system, acting)
    environment = scenario.environment if estimated else None
    told = replace(
        exact_sensors(scenario, wrenches(unit.system) if estimated else {}),
        environment=environment,
        before_s=0.0,  # the first block begins at the start of the motion
    )
    with tempfile.TemporaryDirectory(prefix="study-") as folder:
        problem = problem_of(write_config(told, unit.seed, Path(folder)))
    mean = problem.prior_mean.copy()
    mean[problem.bodies] = truth_of(scenario)
    return replace(problem, prior_mean=mean)


@lru_cache(maxsize=2)
def _blocks(orbit: str, system: str, acting: str) -> tuple[Block, ...]:
    history = history_of(orbit, system, acting)
    count = int(history.end_s / WINDOW_S)
    weights = _covariances(orbit, system, history.q.shape[1])
    return tuple(_block(orbit, system, history, k, weights) for k in range(count))


def _block(
    orbit: str, system: str, history: TruthHistory, index: int, weights: dict[str, FloatArray]
) -> Block:
    t_s = WINDOW_S * index + 0.5 * WINDOW_S * (1.0 + gauss_nodes(NODES))
    s = history.at(t_s)
    place = bound_sensors(scenario_of(orbit, system, NONE), s.q.shape[1]).p_BS_m
    px, py, pz = place.tolist()
    return Block(
        index=index,
        t_ns=np.rint(t_s * 1e9).astype(np.int64),
        q_rad=s.q,
        qd_rad_s=s.qd,
        qdd_rad_s2=s.qdd,
        tau_nm=s.tau,
        w_NB_B_rad_s=s.w_NB_B,
        wd_NB_B_rad_s2=s.wd_NB_B,
        f_NS_B_m_s2=specific_force(s, (px, py, pz), np.eye(3)),
        R_NB=s.R_NB,
        **weights,
        has_joint=np.ones(s.q.shape[1], dtype=bool),
        has_gyro=True,
        has_accelerometer=True,
        has_attitude=True,
    )


@lru_cache(maxsize=3)
def _covariances(orbit: str, system: str, n: int) -> dict[str, FloatArray]:
    """Return the covariances that conditioning gives for the data sheet's noise in a window."""
    sensors = bound_sensors(scenario_of(orbit, system, NONE), n)
    half = 0.5 * WINDOW_S
    joints, imu = _instants(sensors.joint_rate_hz), _instants(sensors.imu_rate_hz)
    high = NodeFit(joints, half, NODES + 2, NODES)
    low = NodeFit(joints, half, NODES - 1, NODES)
    inertial = NodeFit(imu, half, NODES - 1, NODES)
    return {
        "cov_joint": np.stack([high.covariance((1, 2), POSITION_NOISE_RAD)] * n),
        "cov_tau": np.stack([low.covariance((0,), float(sensors.torque_noise_nm[0]))] * n),
        "cov_gyro": inertial.covariance((0, 1), sensors.gyro_noise_rad_s),
        "cov_acc": inertial.covariance((0,), sensors.acc_noise_m_s2),
    }


def _instants(rate_hz: float) -> FloatArray:
    """Return the sample times of a window relative to its middle [s]."""
    times = (np.arange(round(WINDOW_S * rate_hz)) + 0.5) / rate_hz - 0.5 * WINDOW_S
    return np.asarray(times, dtype=np.float64)
