"""A wrench sensor on the robot of `estimator_cases`: configuration, blocks, and its wrench."""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from fsw.config import Config
from fsw.estimators.model.building import build_problem, robot_of
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray
from tests.support.estimator_cases import URDF, random_block

GRAVITY = (0.0, 0.0, -9.80665)
PLACE = (0.03, -0.02, 0.11)
TURN = (0.3, -0.5, 1.2)


def wrist(**changes: Any) -> dict[str, Any]:
    """Return the section of a sensor in front of the target."""
    return {
        "name": "wrist",
        "rate_hz": 500.0,
        "frame": "tool",
        "force_limit_n": 1e4,
        "torque_limit_nm": 1e3,
        "force_noise_n": 0.2,
        "torque_noise_nm": 0.01,
        "force_offset_sigma_n": 2.0,
        "torque_offset_sigma_nm": 0.1,
        "scale_sigma_ratio": 0.0,
    } | changes


def with_wrist(
    config: Config, motion: str = "free", gravity: Any = (0.0, 0.0, 0.0), **changes: Any
) -> Config:
    """Return the configuration with the sensor, and a base held in this way."""
    base = {"motion": motion, "gravity_B_m_s2": gravity}
    return config.with_sections(wrench_sensors=[wrist(**changes)], base=base)


def wrist_problem(config: Config, *, exact: bool = False) -> Problem:
    return build_problem(config, robot_of(config), exact=exact)


def with_axes(block: Block, axes: int = 6, sigma: float = 0.01) -> Block:
    """Return the block with zero readings of a wrench sensor."""
    m = len(block.t_ns)
    return replace(
        block,
        tau_nm=np.concatenate([block.tau_nm, np.zeros((m, axes))], axis=1),
        cov_tau=np.concatenate([block.cov_tau, np.stack([sigma**2 * np.eye(m)] * axes)]),
        has_joint=np.concatenate([block.has_joint, np.ones(axes, np.bool_)]),
    )


def wrist_block(seed: int = 1) -> Block:
    return with_axes(random_block(seed))


def plain_model(pi: FloatArray) -> pin.Model:
    """Return Pinocchio's own model of the robot with parameters pi (10 (n + 1),)."""
    own = pin.buildModelFromUrdf(str(URDF), pin.JointModelFreeFlyer())
    own.gravity.setZero()
    for k in range(1, own.njoints):
        own.inertias[k] = pin.Inertia.FromDynamicParameters(pi[10 * (k - 1) : 10 * k])
    return own
