"""Wrench that a force-torque sensor in the arm measures, from MuJoCo's own inverse dynamics."""

from collections.abc import Sequence

import mujoco
import numpy as np

from hil.world.history import TruthState
from hil.world.inertia import FloatArray
from hil.world.robot import BASE_NQ, BASE_NV, Robot


def wrenches(
    robot: Robot,
    state: TruthState,
    link: str,
    p_LS_m: Sequence[float],
    R_LS: FloatArray,
    gravity_N_m_s2: Sequence[float] = (0.0, 0.0, 0.0),
) -> FloatArray:
    """Return force [N] and moment about S [N m] (k, 6), in axes of S, by which a link is held.

    Parameters
    ----------
    robot : without slides and wheels
    state : at k times
    link : first link that the sensor carries
    p_LS_m, R_LS : origin and axes of the sensor in the frame of the link

    Raises
    ------
    ValueError if the robot has coordinates besides those of base and arm.
    """
    model = robot.model
    if model.nv != BASE_NV + robot.n:
        raise ValueError("a robot with slides or wheels has no wrench sensor here")
    model.opt.gravity[:] = gravity_N_m_s2
    data, body = mujoco.MjData(model), int(model.body(link).id)
    found = np.empty((len(state.q), 6))
    for k in range(len(state.q)):
        R_NB = state.R_NB[k]
        data.qpos[:3], data.qpos[3:BASE_NQ] = state.p_NB_N[k], np.roll(state.q_NB_xyzw[k], 1)
        data.qvel[:3], data.qvel[3:BASE_NV] = state.v_NB_N[k], state.w_NB_B[k]
        data.qpos[BASE_NQ:], data.qvel[BASE_NV:] = state.q[k], state.qd[k]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        data.qacc[:3], data.qacc[3:BASE_NV] = R_NB @ state.a_NB_B[k], state.wd_NB_B[k]
        data.qacc[BASE_NV:] = state.qdd[k]
        mujoco.mj_rnePostConstraint(model, data)
        moment, force = np.split(data.cfrc_int[body], 2)  # in N, about the robot's centre of mass
        R_NS = data.xmat[body].reshape(3, 3) @ R_LS
        place = data.xpos[body] + data.xmat[body].reshape(3, 3) @ np.asarray(p_LS_m)
        moment = moment + np.cross(data.subtree_com[model.body_rootid[body]] - place, force)
        found[k] = np.concatenate([R_NS.T @ force, R_NS.T @ moment])
    return found
