"""Windows along a motion: what a conditioner makes of them is the motion."""

import numpy as np
import pytest

from fsw.config import Config
from fsw.estimators.model.building import build_problem
from planner import left_out
from planner.nominal import nominal_motion
from tests.support.estimator_cases import make_config, robot_model

JOINT = 2


def by_speed() -> Config:
    """Return a configuration in which one encoder gives speed only, from a start that is wrong."""
    data = make_config().model_dump()
    data["joints"] = [dict(joint) for joint in data["joints"]]
    data["joints"][JOINT] |= {"encoder": "speed", "speed_noise_rad_s": 1e-5, "start_rad": 1.0}
    return Config.model_validate(data)


@pytest.mark.parametrize("config", [make_config(), by_speed()], ids=["positions", "speed"])
def test_blocks_follow_the_motion_whatever_the_encoders_measure(config):
    problem = build_problem(config, robot_model())
    motion = nominal_motion(config, problem.model)
    blocks = left_out.blocks_along(config, problem, motion)
    assert len(blocks) == int(motion.duration_s / config.estimator.window_s)
    for block in blocks[::7]:
        q, qd, qdd = motion.evaluate(1e-9 * block.t_ns)[:3]
        np.testing.assert_allclose(block.q_rad, q, atol=1e-5)
        np.testing.assert_allclose(block.qd_rad_s, qd, atol=1e-4)
        np.testing.assert_allclose(block.qdd_rad_s2, qdd, atol=1e-2)
