"""The recording's own clock, and the published arm."""

import numpy as np
import pinocchio as pin

from evidence.hardware.robots.panda import STEP_S, URDF, clock


def test_steps_of_the_controller_are_found_between_lost_samples():
    rng = np.random.default_rng(1)
    steps = rng.choice([1, 2, 5], size=4000, p=[0.9, 0.08, 0.02])
    t = STEP_S * np.concatenate([[0], np.cumsum(steps)])
    phase = rng.uniform(0.0, 6.0, 7)
    q, qd = np.sin(2.0 * t[:, None] + phase), 2.0 * np.cos(2.0 * t[:, None] + phase)
    q = np.round(q + 2e-6 * rng.standard_normal(q.shape), 6)
    assert np.array_equal(np.rint(clock(q, qd) / STEP_S), np.rint(t / STEP_S))


def test_the_robot_is_the_published_arm():
    """Masses as Gaz et al. print them; the flange 1.033 m above the table when all angles are 0."""
    model = pin.buildModelFromUrdf(str(URDF))
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.zeros(7))
    flange = data.oMf[model.getFrameId("flange")].translation
    assert np.allclose(flange, [0.088, 0.0, 0.333 + 0.316 + 0.384 - 0.107], atol=1e-9)
    assert np.isclose(sum(inertia.mass for inertia in model.inertias), 16.692, atol=1e-3)
