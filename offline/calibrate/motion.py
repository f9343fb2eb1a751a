"""Calibration in motion: one batch with wide priors estimates all errors of the sensors."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fsw.config import Config, ImuConfig, JointConfig
from fsw.config.consistency import MOST_DELAY
from fsw.errors import EstimatorError
from fsw.estimators.batch.run import sound_blocks, with_noise_found
from fsw.estimators.batch.settle import settle
from fsw.estimators.batch.solver import Progress
from fsw.estimators.conditioning.rotation import rotation_from_xyzw
from fsw.estimators.effects import delay
from fsw.estimators.measurement.mounting import gyro_turn
from fsw.estimators.measurement.row_functions import Linearisation, row_function
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.model.state_group import StateGroup
from fsw.estimators.model.state_groups import GROUPS
from fsw.messages import Block, FloatArray, Window
from offline.calibrate.figures import DELAY_KEYS, Figure, in_axes, sensor_axes, stated
from offline.calibrate.time_offset import MOST_S, tracker_offset
from offline.watching import Watching

OF_JOINTS = [group for group in GROUPS if group.joint_key and group.calibrated_from]
OF_IMU = [group for group in GROUPS if group.section == "imu" and group is not delay.IMU]
STATED_DELAY_S = 2e-3  # assumed 1 sigma of a configured delay: no key states it
WORTH_S = 5e-4  # a delay that is wrong by more is corrected, and the recording is replayed again
ROUNDS = 4
MOST_DELAY_S = {"gyro": 0.1, "accelerometer": 0.1, "star_tracker": 10.0}  # bounds of the keys

Read = Callable[[Config], Watching]


def motion_figures(config: Config, read: Read, progress: Progress | None) -> list[Figure]:
    """Return offsets, scales, biases, mounting and delays from a recording in motion.

    A robot with joints: method fused, with wide priors on all of these figures. A body without
    joints: method mrnea with the configured priors, and no delays of the inertial unit. Scales and
    axes of the gyro are estimated only if configured as uncertain, with the configured priors.

    Parameters
    ----------
    read : replays the recordings with a configuration

    Raises
    ------
    EstimatorError if no window is usable, or the fit does not converge or explain the residuals.
    """
    model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
    stamped = config
    for last in reversed(range(ROUNDS)):
        problem = build_problem(_widened(stamped), model)
        seen = read(stamped)
        blocks = sound_blocks(seen.made)
        if not blocks:
            raise EstimatorError("no usable window in this recording")
        mean, covariance = _solved(problem, blocks, config.estimator.gate_probability, progress)
        later = _later(stamped, problem, mean, covariance)
        if later is stamped or not last:
            break
        stamped = later
    found = _figures(config, stamped, problem, mean, covariance)
    return [*found, *_tracker(config, stamped, problem, mean, seen.windows, found)]


def _widened(config: Config) -> Config:
    """Return the configuration with prior sigmas of sensor errors of at least the wide ones.

    A body without joints keeps its priors: centre of mass and unit's place are not separable.
    """
    if not config.joints:
        return config
    most_s = MOST_DELAY * config.estimator.window_s
    joints = [
        {**joint.model_dump(), **joint.named(_wider(vars(joint), OF_JOINTS, most_s))}
        if joint.torque != "none"
        else joint.model_dump()
        for joint in config.joints
    ]
    if not config.imu.present:
        return config.with_sections(joints=joints)
    imu = config.imu.model_dump()
    return config.with_sections(joints=joints, imu=imu | _wider(imu, [*OF_IMU, delay.IMU], most_s))


def _wider(
    section: dict[str, Any], groups: Sequence[StateGroup], most_delay_s: float
) -> dict[str, float]:
    sigmas = {own.field: max(section[own.field], own.calibrated_from) for own in groups}
    short = {own.field: most_delay_s for own in groups if own in delay.GROUPS}
    return {key: min(sigma, short.get(key, sigma)) for key, sigma in sigmas.items()}


def _solved(
    problem: Problem, blocks: Sequence[Block], gate_probability: float, progress: Progress | None
) -> tuple[FloatArray, FloatArray]:
    """Return mean (p,) and covariance (p, p) of the whole state from one batch."""
    noisy, _ = with_noise_found(problem, blocks)
    rows = row_function("fused" if problem.model.n else "mrnea", "eiv", problem)
    settled = settle(problem, Linearisation(rows, noisy), noisy, gate_probability, progress, None)
    solution = settled.solution
    if solution.status == "NOT_CONVERGED":
        raise EstimatorError("no figures: the fit does not converge on these data")
    if settled.mismatch:
        raise EstimatorError(
            "no figures: no offset, scale, bias, mounting or delay explains these residuals; "
            "`fsw check CONFIG RECORDING` looks for other mistakes"
        )
    return solution.mean, settled.covariance


def _later(config: Config, problem: Problem, mean: FloatArray, covariance: FloatArray) -> Config:
    """Return the configuration with significant delays added; `config` itself if there are none."""
    changes = {}
    for sensor, key in DELAY_KEYS.items():
        if problem.has(delay.IMU.name):
            k = problem.names.index(f"{delay.IMU.name}.{sensor}")
            found, before = float(mean[k]), getattr(config.imu, key)
            now = min(max(before + found, 0.0), MOST_DELAY_S[sensor])
            if abs(found) > max(WORTH_S, 2.0 * covariance[k, k] ** 0.5) and now != before:
                changes[key] = now
    return config.with_sections(imu=config.imu.model_dump() | changes) if changes else config


def _figures(
    config: Config, stamped: Config, problem: Problem, mean: FloatArray, covariance: FloatArray
) -> list[Figure]:
    joints = {joint.name: joint for joint in config.joints}
    sigma = np.sqrt(np.diag(covariance))
    found = []
    for group in OF_JOINTS:
        states, kind = problem.at(group.name), group.name
        for k, name in zip(
            range(states.start, states.stop), problem.model.joint_names, strict=True
        ):
            if joints[name].torque != "none":
                value, own = float(mean[k]), float(sigma[k])
                if group is delay.TORQUE:
                    found.append(_of_torque(joints[name], value, own, config.estimator.window_s))
                    continue
                known = _known(joints[name], group.field)
                found.append(Figure(kind=kind, which=name, value=value, sigma=own, known=known))
    for group in OF_IMU:
        states, kind = problem.at(group.name), group.name
        if problem.has(kind):
            R = sensor_axes(config) if "bias" in kind else np.eye(3)
            known = _known(config.imu, group.field)
            found += in_axes(kind, mean[states], covariance[states, states], R, known)
    for sensor, key in DELAY_KEYS.items() if problem.has(delay.IMU.name) else ():
        k = problem.names.index(f"{delay.IMU.name}.{sensor}")
        before, now = (getattr(c.imu, key) for c in (config, stamped))
        found.append(_delay(sensor, before, now - before + float(mean[k]), float(sigma[k])))
    return found


def _of_torque(joint: JointConfig, value: float, sigma: float, window_s: float) -> Figure:
    """Return the figure of a torque's delay; one that is as good as none is not used."""
    most_s, refused = MOST_DELAY * window_s, ""
    if abs(value) < max(WORTH_S, 2.0 * sigma):
        refused = "none, not used"
    elif abs(joint.torque_delay_s + value) > most_s:
        refused = f"beyond {most_s:g} s, a tenth of a window: correct the stamps"
    known = joint.torque_delay_sigma_s or STATED_DELAY_S
    return Figure(
        kind=delay.TORQUE.name,
        which=joint.name,
        value=value,
        sigma=sigma,
        known=known,
        refused=refused,
    )


def _delay(sensor: str, configured_s: float, change_s: float, sigma_s: float) -> Figure:
    refused = ""
    if not 0.0 <= configured_s + change_s <= MOST_DELAY_S[sensor]:
        refused = "not possible as a delay of this sensor: look at buses[].latch_offset_s"
    return Figure(
        kind="delay",
        which=sensor,
        value=change_s,
        sigma=sigma_s,
        known=STATED_DELAY_S,
        refused=refused,
    )


def _known(section: JointConfig | ImuConfig, key: str) -> float:
    """Return the configured sigma; if it is 0, the key's default; inf if that is 0 too."""
    default = type(section).model_fields[key].default
    return stated(getattr(section, key) or (default if isinstance(default, float) else 0.0))


def _tracker(
    config: Config,
    stamped: Config,
    problem: Problem,
    mean: FloatArray,
    windows: Sequence[Window],
    found: Sequence[Figure],
) -> list[Figure]:
    """Return the figure of the star tracker's delay; none without tracker or inertial unit.

    The delay is measured relative to the gyro, whose own delay is that of the overlay.
    """
    tracker = config.star_tracker
    if tracker is None or not config.imu.present:
        return []
    R_BT = rotation_from_xyzw(np.array(tracker.mounting.q_BS_xyzw))
    R_BS = rotation_from_xyzw(np.array(config.imu.mounting.q_BS_xyzw))
    gyro = [window.gyro for window in windows]
    rates = np.concatenate([channel.values for channel in gyro]) @ R_BS.T
    gyro_ns = np.concatenate([channel.t_ns for channel in gyro])
    good = np.isfinite(rates).all(axis=1)
    solutions = [window.attitude for window in windows if len(window.attitude.t_ns)]
    if not solutions or not good.any():
        return [_delay("star_tracker", tracker.latency_s, 0.0, MOST_S)]
    t_ns = np.concatenate([channel.t_ns for channel in solutions])
    R_NB = Rotation.from_quat(np.concatenate([channel.values for channel in solutions]))
    across, about = tracker.noise_across_rad, tracker.noise_about_rad
    offset_s, sigma_s = tracker_offset(
        (t_ns - gyro_ns[0]) * 1e-9,
        R_NB * Rotation.from_matrix(R_BT),
        (gyro_ns[good] - gyro_ns[0]) * 1e-9,
        rates[good] @ gyro_turn(mean, problem).T @ R_BT,
        np.array([across, across, about]),
        config.imu.angle_random_walk_rad_sqrt_s,
    )
    if not np.isfinite(sigma_s):
        return [_delay("star_tracker", tracker.latency_s, 0.0, MOST_S)]
    changed_s = stamped.imu.gyro_group_delay_s - config.imu.gyro_group_delay_s
    gyro_s, gyro_sigma_s = gyro_delay(found)
    sigma_s = float(np.hypot(sigma_s, gyro_sigma_s))
    return [_delay("star_tracker", tracker.latency_s, offset_s + gyro_s - changed_s, sigma_s)]


def gyro_delay(found: Sequence[Figure]) -> tuple[float, float]:
    """Return the measured delay of the gyro and its sigma [s]; zeros where it is not measured.

    Without joints nothing measures it.
    """
    own = [figure for figure in found if figure.name == "delay.gyro" and figure.measured]
    return (own[0].value, own[0].sigma) if own else (0.0, 0.0)
