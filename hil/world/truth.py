"""The plant's dynamics: MuJoCo multibody truth, an engine the estimator does not use.

The robot floats freely without gravity, contacts or friction, or is on a stand in a laboratory. Its
momentum is zero unless it tumbles at the start or a wrench acts. The joint controller runs in every
stage of every integration step, so it has no sampling delay.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from hil.world.history import Field, TruthHistory, TruthState
from hil.world.links import Body, load_bodies
from hil.world.robot import BASE_NQ, BASE_NV, Robot
from hil.world.spline import Motion
from hil.world.springs import Springs
from hil.world.stand import Stand

__all__ = ["Body", "Robot", "TruthHistory", "TruthState", "load_bodies", "simulate"]

FloatArray = NDArray[np.float64]

# (time [s], MuJoCo data at that time) -> None; writes data.xfrc_applied: per body force [N] and
# torque [N m] at its centre of mass, in inertial axes.
Wrench = Callable[[float, Any], None]

POSITION_GAIN_1_S2 = 100.0
SPEED_GAIN_1_S = 20.0
STILL = (0.0, 0.0, 0.0)


class _Plant:
    """State derivative of the controlled free-floating robot.

    State: MuJoCo's qpos and qvel in a row. qpos: base position (N), quaternion (w x y z), slides,
    wheels, joints. qvel: base velocity (N), base angular velocity (B), slides, wheels, joints.
    """

    def __init__(self, robot: Robot, wrench: Wrench | None, stand: Stand | None) -> None:
        if stand is not None and robot.slides:
            raise ValueError("a base on a stand holds no liquid and no panel here")
        self.stand = stand
        self.model = robot.model
        self.model.opt.gravity[:] = 0.0 if stand is None else stand.gravity_m_s2
        self.data = data = mujoco.MjData(robot.model)
        self.qpos, self.qvel = data.qpos, data.qvel  # views: access to the attributes is slow
        self.wrench = wrench
        self.wheels, self.thrusters = robot.wheels, robot.thrusters
        turning = 0 if robot.wheels is None else len(robot.wheels.rotors)
        self.liquid = BASE_NV + len(robot.slides)  # index of the first wheel's velocity
        self.passive = self.liquid + turning  # number of velocities before the arm's
        self.motor = np.zeros(turning)
        self.held_wxyz = np.array([1.0, 0.0, 0.0, 0.0])  # attitude that the wheels hold
        self.nq = self.passive + 1 + robot.n
        self.H = np.zeros((self.passive + robot.n, self.passive + robot.n))
        self.c = np.zeros(self.passive + robot.n)
        self.tau = np.zeros(robot.n)
        self.springs = Springs(robot.slides) if robot.slides else None

    def derivative(
        self, t_s: float, y: FloatArray, wanted: tuple[FloatArray, FloatArray, FloatArray]
    ) -> FloatArray:
        """Return dy/dt under computed-torque control to `wanted` (q, qd, qdd); store self.tau.

        The controller cancels the dynamics with the reaction of the passive coordinates b
        eliminated, a_b = -H_bb^-1 (c_b + H_bm qdd). It compensates the thrusters' wrench, so
        that joints do not give way to a firing, and no other external wrench.
        """
        model, data, nq = self.model, self.data, self.nq
        self.qpos[:] = y[:nq]
        self.qvel[:] = y[nq:]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, self.c)
        mujoco.mj_fullM(model, data, self.H)
        H, c, m = self.H, self.c, self.passive
        q, qd, qdd = wanted
        command = (
            qdd + SPEED_GAIN_1_S * (qd - y[nq + m :]) + POSITION_GAIN_1_S2 * (q - y[m + 1 : nq])
        )
        if self.springs is not None:
            s = self.liquid
            c[BASE_NV:s] -= self.springs.force_n(y[BASE_NQ : s + 1], y[nq + BASE_NV : nq + s])
        if self.thrusters is not None:
            fired = self.thrusters.wrench(t_s)
            c[:3] -= self.data.xmat[1].reshape(3, 3) @ fired[:3]  # MuJoCo's free joint: axes of N
            c[3:BASE_NV] -= fired[3:]
        if self.wheels is not None:
            w_B, speed = y[nq + 3 : nq + BASE_NV], y[nq + self.liquid : nq + m]
            turned = _turned(self.held_wxyz, y[3:7])
            self.motor = self.wheels.motor_torque_nm(turned, w_B, speed)
            c[self.liquid : m] -= self.motor
        force = H[:, m:] @ command + c  # on every coordinate if the base is held
        if self.stand is None:
            _, reaction, info = dposv(H[:m, :m], -force[:m])
            if info != 0:
                raise ValueError(f"base inertia not positive definite at t = {t_s} s")
        else:
            reaction = self.stand.give(H[:m, :m], -force[:m])
        self.tau = H[m:, :m] @ reaction + force[m:]
        rate = np.empty(len(y))
        rate[:3] = y[nq : nq + 3]
        rate[3:BASE_NQ] = _quaternion_rate(y[3:7], y[nq + 3 : nq + BASE_NV])
        rate[BASE_NQ:nq] = y[nq + BASE_NV :]
        rate[nq : nq + m], rate[nq + m :] = reaction, command
        if self.wrench is not None:
            rate[nq:] += self._disturbance(t_s, self.wrench)
        return rate

    def turning(self, places: Sequence[FloatArray], w_NB_B_rad_s: Sequence[float]) -> FloatArray:
        """Return the base's velocity (6,) in a rotation of the robot about its centre of mass."""
        self.qpos[:] = np.concatenate(places)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        lever_N = self.data.xpos[1] - self.data.subtree_com[0]
        w_N = self.data.xmat[1].reshape(3, 3) @ np.array(w_NB_B_rad_s)
        return np.concatenate([np.cross(w_N, lever_N), w_NB_B_rad_s])

    def _disturbance(self, t_s: float, wrench: Wrench) -> FloatArray:
        """Return the acceleration H^-1 J^T f that the external wrench adds to the commanded one."""
        data = self.data
        data.xfrc_applied[:] = 0.0
        wrench(t_s, data)
        force = np.zeros(len(self.c))
        for body in np.flatnonzero(data.xfrc_applied.any(axis=1)):
            f, t = data.xfrc_applied[body, :3], data.xfrc_applied[body, 3:]
            mujoco.mj_applyFT(self.model, data, f, t, data.xipos[body], int(body), force)
        _, acceleration, _ = dposv(self.H, force)
        return np.asarray(acceleration, dtype=np.float64)


def _turned(from_wxyz: FloatArray, to_wxyz: FloatArray) -> FloatArray:
    """Return the quaternion's vector part (3,) of the shorter rotation between attitudes, in B."""
    w, v = from_wxyz[0], from_wxyz[1:]
    vector = w * to_wxyz[1:] - to_wxyz[0] * v - np.cross(v, to_wxyz[1:])
    scalar = w * to_wxyz[0] + v @ to_wxyz[1:]
    return np.asarray(vector if scalar >= 0.0 else -vector)


def _quaternion_rate(quat_wxyz: FloatArray, w_B: FloatArray) -> tuple[float, ...]:
    qw, qx, qy, qz = quat_wxyz.tolist()
    a, b, c = (0.5 * w_B).tolist()
    return (
        -qx * a - qy * b - qz * c,
        qw * a + qy * c - qz * b,
        qw * b + qz * a - qx * c,
        qw * c + qx * b - qy * a,
    )


def simulate(
    robot: Robot,
    spline: Motion,
    start_s: float,
    end_s: float,
    dt_s: float = 0.004,
    *,
    wrench: Wrench | None = None,
    field: Field | None = None,
    stand: Stand | None = None,
    q_NB_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
    w_NB_B_rad_s: tuple[float, float, float] = STILL,
) -> TruthHistory:
    """Simulate the robot on a joint trajectory; the base origin starts at the origin of N.

    Classical Runge-Kutta of order four over the MuJoCo state, quaternion normalised each step.

    Parameters
    ----------
    robot : model with as many joints as the spline
    spline : motion over [0, duration]; the robot rests outside it
    start_s, end_s : simulated interval; end is rounded up to a whole step
    wrench : external forces, called at every stage; the controller does not compensate them
    field : gravity in the freely falling frame N, stored in the history for the sensors; the
        motion has it only if `wrench` includes it
    stand : laboratory stand of the base, with gravity; None: the base floats freely
    q_NB_xyzw : base attitude at the start
    w_NB_B_rad_s : rate of the base at the start; the robot's centre of mass is at rest

    Raises
    ------
    ValueError if the spline has other joints, the interval is empty, or a stand has a start rate.
    """
    if stand is not None and any(w_NB_B_rad_s):
        raise ValueError("a base on a stand does not tumble")
    field = stand if stand is not None else field
    if spline.n != robot.n:
        raise ValueError(f"spline has {spline.n} joints, robot {robot.n}")
    steps = int(np.ceil((end_s - start_s) / dt_s - 1e-9))
    if steps < 1:
        raise ValueError(f"end_s {end_s} must be after start_s {start_s}")
    plant = _Plant(robot, wrench, stand)
    times = start_s + 0.5 * dt_s * np.arange(2 * steps + 1)
    wanted = spline.evaluate(times)
    q, qd, qdd = wanted
    x, y_, z, w = np.array(q_NB_xyzw) / np.linalg.norm(q_NB_xyzw)
    liquid = np.zeros(len(robot.slides))
    rotors = () if robot.wheels is None else robot.wheels.rotors
    speeds = np.array([rotor.speed_rad_s for rotor in rotors])
    plant.held_wxyz = np.array([w, x, y_, z])
    places = [np.zeros(3), plant.held_wxyz, liquid, 0.0 * speeds, q[0]]
    y = np.concatenate([*places, plant.turning(places, w_NB_B_rad_s), liquid, speeds, qd[0]])
    states = np.empty((steps + 1, len(y)))
    rates = np.empty((steps + 1, len(y)))
    torques = np.empty((steps + 1, robot.n))
    motors = np.empty((steps + 1, len(rotors)))
    centres = np.empty((steps + 1, 3))

    def rate(k: int, state: FloatArray) -> FloatArray:
        return plant.derivative(float(times[k]), state, (q[k], qd[k], qdd[k]))

    for k in range(steps + 1):
        k1 = rate(2 * k, y)
        states[k], rates[k], torques[k] = y, k1, plant.tau
        centres[k] = plant.data.subtree_com[0]
        motors[k] = plant.motor
        if k == steps:
            break
        k2 = rate(2 * k + 1, y + (0.5 * dt_s) * k1)
        k3 = rate(2 * k + 1, y + (0.5 * dt_s) * k2)
        k4 = rate(2 * k + 2, y + dt_s * k3)
        y = y + (dt_s / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)
        y[3:7] /= np.linalg.norm(y[3:7])
    history = _history(start_s, dt_s, states, rates, torques, motors)
    return history if field is None else replace(history, field=field, centre_N=centres)


def _history(
    start_s: float,
    dt_s: float,
    y: FloatArray,
    rate: FloatArray,
    tau: FloatArray,
    motors: FloatArray,
) -> TruthHistory:
    n, turning = tau.shape[1], motors.shape[1]
    others = (y.shape[1] - BASE_NQ - BASE_NV - 2 * n) // 2
    slides, nq = others - turning, BASE_NQ + others + n
    joints = nq + BASE_NV + others
    wheels = slice(joints - turning, joints)
    return TruthHistory(
        start_s=start_s,
        dt_s=dt_s,
        q=y[:, BASE_NQ + others : nq],
        qd=y[:, joints:],
        qdd=rate[:, joints:],
        tau=tau,
        p_N=y[:, :3],
        v_N=y[:, nq : nq + 3],
        a_N=rate[:, nq : nq + 3],
        quat_wxyz=y[:, 3:7],
        w_B=y[:, nq + 3 : nq + 6],
        wd_B=rate[:, nq + 3 : nq + 6],
        liquid_m=y[:, BASE_NQ : BASE_NQ + slides],
        wheel_rad_s=y[:, wheels] if turning else None,
        wheel_rad_s2=rate[:, wheels] if turning else None,
        motor_nm=motors if turning else None,
    )
