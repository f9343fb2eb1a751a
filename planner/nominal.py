"""The nominal motion, used without a planned one: every joint swings, every valve opens."""

import numpy as np

from fsw.config import Config
from fsw.estimators.model.building import joint_order
from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray
from planner.firings import in_turn
from planner.spline import REST_POINTS, Trajectory

DURATION_S = 20.0
POINTS = 40
SWINGS = 1.0  # swings of the first joint; each further joint makes an eighth of a swing more
SWING = {"revolute": 0.3, "prismatic": 0.1}  # largest amplitude [rad or m]
RANGE_SHARE = 0.4  # largest amplitude as a share of the joint's range
SPEED_SHARE = 0.5  # largest speed as a share of the joint's speed limit


def nominal_motion(config: Config, model: RobotModel) -> Trajectory:
    """Return a motion from rest to rest in which no two joints swing at the same frequency."""
    joints = [config.joints[k] for k in joint_order(config, model)]
    lower, upper = (
        np.array(limit[7:])
        for limit in (model.plain.model.lowerPositionLimit, model.plain.model.upperPositionLimit)
    )
    bounded = np.abs(upper - lower) < 2.0 * np.pi
    middle = 0.5 * (np.where(bounded, lower, 0.0) + np.where(bounded, upper, 0.0))
    reach = np.where(bounded, RANGE_SHARE * (upper - lower), np.inf)
    most = np.array([SWING[kind] for kind in model.kinds()])
    turns_rad_s = 2.0 * np.pi * (SWINGS + 0.125 * np.arange(model.n)) / DURATION_S
    speed = np.array([joint.speed_limit_rad_s for joint in joints])
    swing = np.minimum(np.minimum(most, reach), SPEED_SHARE * speed / turns_rad_s)
    inner = np.linspace(0.0, DURATION_S, POINTS)[:, None]
    points: FloatArray = middle + swing * np.sin(turns_rad_s * inner)
    ends = np.repeat(middle[None], REST_POINTS, axis=0)
    return Trajectory(
        duration_s=DURATION_S,
        points_rad=np.concatenate([ends, points, ends]),
        firings=in_turn(config, DURATION_S),
    )
