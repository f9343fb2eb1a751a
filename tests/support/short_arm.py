"""Short recordings of a clamped arm: blocks of known truth, with torques that no model explains."""

from dataclasses import replace

import numpy as np

from fsw.config import Config
from fsw.estimators.conditioning.polynomial import NodeFit, gauss_nodes
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.inertia import to_parameters
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray
from tests.support.estimator_cases import (
    NODES,
    POSITION_NOISE_RAD,
    RATE_HZ,
    WINDOW_S,
    N,
    _factor,
    make_config,
    random_block,
    robot_model,
)

TORQUE_NOISE_NM = 0.1
PAYLOAD = to_parameters(1.4, np.array([0.01, -0.01, 0.06]), np.array([3, 0, 0, 3, 0, 2]) * 1e-3)
GUESS = {
    "mass_kg": 1.0,
    "com_m": [0.0, 0.0, 0.06],
    "inertia_kg_m2": [4e-3, 0.0, 0.0, 4e-3, 0.0, 3e-3],
    "sigma": {
        "mass_kg": 0.5,
        "com_m": [0.06, 0.06, 0.06],
        "inertia_kg_m2": [2e-3, 1e-3, 1e-3, 2e-3, 1e-3, 2e-3],
    },
}
JOINT = {
    "torque_noise_nm": TORQUE_NOISE_NM,
    "torque_offset_sigma_nm": 0.3,
    "torque_scale_sigma_ratio": 0.01,
    "friction_coulomb_sigma_nm": 0.2,
    "friction_viscous_sigma_nms_rad": 0.2,
    "friction_speed_rad_s": 0.03,
}


def short_arm_config(**changes: object) -> Config:
    """Return the configuration of an arm with doubtful links, gains, offsets and friction."""
    data = make_config().model_dump()
    del data["estimator"]["settle_blocks"]
    data["base"] = {"motion": "clamped", "gravity_B_m_s2": [0.0, 0.0, -9.80665]}
    data["imu"] |= {"driver": "none"}
    data["robot"]["links_sigma_ratio"] = 0.05
    data["bodies"]["target"] = GUESS
    data["buses"] = [{"name": "arm", "interface": "samples", "rate_hz": RATE_HZ}]
    data["joints"] = [joint | JOINT for joint in data["joints"]]
    return Config.model_validate(data | changes)


def recorded(
    config: Config, seed: int, windows: int, *, loud_nm: float, fades_s: float
) -> tuple[list[Block], FloatArray]:
    """Return the blocks of a short motion, and the true payload (10,).

    Arm and calibration are drawn from their priors. Beside the sensors' noise each joint has a
    torque that fades in `fades_s`, of its own size, `loud_nm` on the mean.
    """
    rng, problem = np.random.default_rng(seed), build_problem(config, robot_model())
    truth = _drawn(problem, rng)
    t_s, q, qd, qdd = _motion(rng, windows)
    size_nm = loud_nm * np.exp(0.5 * rng.normal(size=N) - 0.125)
    unmodelled_nm = size_nm * _fading(rng, t_s, fades_s)
    high, low = (NodeFit(_instants(), WINDOW_S / 2, NODES + k, NODES) for k in (2, -1))
    covariances = {
        "cov_joint": np.stack([high.covariance((1, 2), POSITION_NOISE_RAD)] * N),
        "cov_tau": np.stack([low.covariance((0,), TORQUE_NOISE_NM)] * N),
    }
    rest, rates = np.zeros((NODES, 3)), _factor(covariances["cov_joint"][0])
    blocks = []
    for k in range(windows):
        own = slice(k * NODES, (k + 1) * NODES)
        exact = replace(
            random_block(),
            index=k,
            t_ns=np.rint(1e9 * t_s[own]).astype(np.int64),
            q_rad=q[own],
            qd_rad_s=qd[own],
            qdd_rad_s2=qdd[own],
            **dict.fromkeys(("w_NB_B_rad_s", "wd_NB_B_rad_s2", "f_NS_B_m_s2"), rest),
            R_NB=np.repeat(np.eye(3)[None], NODES, axis=0),
            **covariances,
            **dict.fromkeys(("has_gyro", "has_accelerometer", "has_attitude"), False),
        )
        noise = _factor(covariances["cov_tau"][0]) @ rng.normal(size=(NODES, N))
        off = rates @ rng.normal(size=(2 * NODES, N))
        blocks.append(
            replace(
                exact,
                tau_nm=predict(exact, truth, problem).tau_nm + noise + unmodelled_nm[own],
                qd_rad_s=qd[own] + off[:NODES],
                qdd_rad_s2=qdd[own] + off[NODES:],
            )
        )
    return blocks, PAYLOAD


def _drawn(problem: Problem, rng: np.random.Generator) -> FloatArray:
    sigma = np.sqrt(np.diag(problem.prior_covariance))
    truth = problem.prior_mean + sigma * rng.normal(size=len(sigma))
    truth[problem.body("target")] = PAYLOAD
    friction = [k for k, name in enumerate(problem.names) if name.startswith("friction")]
    truth[friction] = np.abs(truth[friction])
    return np.asarray(truth)


def _instants() -> FloatArray:
    samples = round(WINDOW_S * RATE_HZ)
    return (np.arange(samples) + 0.5) / RATE_HZ - WINDOW_S / 2


def _motion(rng: np.random.Generator, windows: int) -> tuple[FloatArray, ...]:
    """Return times, angles, rates and accelerations at the nodes: five harmonics per joint."""
    t_s = (WINDOW_S * (np.arange(windows)[:, None] + 0.5 + 0.5 * gauss_nodes(NODES))).ravel()
    rates = 2.0 * np.pi * np.array([0.1, 0.2, 0.35, 0.5, 0.7])
    size = 0.25 * rng.normal(size=(N, 5)) / np.sqrt(rates / rates[0])
    phase = rates * t_s[:, None, None] + rng.uniform(0.0, 2.0 * np.pi, (N, 5))
    waves = (np.sin(phase), rates * np.cos(phase), -(rates**2) * np.sin(phase))
    q, qd, qdd = ((size * wave).sum(axis=2) for wave in waves)
    return t_s, rng.uniform(-1.0, 1.0, N) + q, qd, qdd


def _fading(rng: np.random.Generator, t_s: FloatArray, fades_s: float) -> FloatArray:
    """Return processes (k, N) of unit variance whose correlation fades by e in `fades_s`."""
    made = rng.normal(size=(len(t_s), N))
    for k in range(1, len(t_s)):
        a = np.exp(-(t_s[k] - t_s[k - 1]) / fades_s)
        made[k] = a * made[k - 1] + np.sqrt(1.0 - a * a) * made[k]
    return made
