"""The usual mistakes of a configuration or of a source: one declaration each.

Those of the description of joints are in `mistakes_of_wires.py`.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import combinations, permutations, product
from math import degrees, radians

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from fsw.config import Config, JointConfig
from fsw.config.constants import STANDARD_GRAVITY_M_S2
from fsw.config.joints import GAIN_OF_CURRENT, LOAD_OF_CURRENT, OF_MOTOR_CURRENT
from fsw.estimators.conditioning.rotation import rotation_from_xyzw
from fsw.messages import FloatArray
from offline.checks.mistake import SHIFTS_S, Mistake
from offline.checks.mistakes_of_wires import described_units
from offline.checks.trial import ACCELEROMETER, GYRO, Trial

QUATERNION = "imu.mounting.q_BS_xyzw"
FRICTION_SHARE = 0.3  # prior sigma of undeclared friction over the rms torque
LEAST_SPEED = 1e-3  # [rad/s or m/s] of the mean speed at which viscous friction may be as large


def usual_mistakes(trial: Trial) -> list[Mistake]:
    """Return the mistakes to try for a configuration and its recorded sources."""
    config = trial.config
    return [
        *signs(config),
        *_exchanges(config),
        *_units(config),
        *described_units(config),
        *_clocks(config),
        *_gravity(config),
        *_friction(config),
        *_motors(config),
        *_wrenches(config),
        *(_mountings(config) if config.imu.present else ()),
        *(_axes() if config.imu.present else ()),
    ]


def signs(config: Config) -> Iterator[Mistake]:
    """Yield the wrong signs of one joint, and of all."""
    n = len(config.joints)
    for k, joint in enumerate(config.joints):
        key, turned = f"joints.{k}", np.where(np.arange(n) == k, -1.0, 1.0)
        gain = f"set {key}.torque_gain to {-joint.torque_gain:g}"
        yield Mistake(
            text=f"{key}.sign ({joint.name}): {joint.sign} should be {-joint.sign}",
            change=partial(Trial.reread, position=turned, torque=turned),
        )
        yield Mistake(
            text=f"{key} ({joint.name}): its torque alone counts the other way (proximal "
            f"side, or mounted reversed); {gain}",
            change=partial(Trial.reread, torque=turned),
        )
        yield Mistake(
            text=f"{key} ({joint.name}): its position alone counts the other way; set {key}.sign "
            f"to {-joint.sign} and {gain}",
            change=partial(Trial.reread, position=turned),
        )
    if n < 2:
        return
    yield Mistake(
        text="joints: all torques count the other way (as torques on the link, or those of some "
        "controllers); multiply every torque_gain by -1",
        change=partial(Trial.reread, torque=-1.0),
    )
    yield Mistake(
        text="joints: all positions count the other way; multiply every sign and every torque_gain "
        "by -1",
        change=partial(Trial.reread, position=-1.0),
    )
    yield Mistake(
        text="joints: all positions and torques count the other way; multiply every sign by -1",
        change=partial(Trial.reread, position=-1.0, torque=-1.0),
    )


def _exchanges(config: Config) -> Iterator[Mistake]:
    joints = config.joints
    for i, k in combinations(range(len(joints)), 2):
        places = list(range(len(joints)))
        places[i], places[k] = k, i
        names = f"({joints[i].name}, {joints[k].name})"
        key = _identity(joints[i], joints[k])
        yield Mistake(
            text=f"joints.{i}{key} and joints.{k}{key} {names}: swapped",
            change=partial(Trial.reread, positions_of=places, torques_of=places),
        )
        yield Mistake(
            text=f"joints.{i} and joints.{k} {names}: their torques are exchanged, their positions "
            "are not; look at the columns of the torques",
            change=partial(Trial.reread, torques_of=places),
        )
        yield Mistake(
            text=f"joints.{i} and joints.{k} {names}: their positions are exchanged, their torques "
            "are not; look at the columns of the positions",
            change=partial(Trial.reread, positions_of=places),
        )


def _identity(*joints: JointConfig) -> str:
    """Return the key that says which device a joint is; empty: its place in the list, of a feed."""
    if all(joint.driver == "described" for joint in joints):
        return ".signals"
    return "" if any(joint.node_id is None for joint in joints) else ".node_id"


def _units(config: Config) -> Iterator[Mistake]:
    turning = np.array([joint.kind == "revolute" for joint in config.joints])
    for factor, found, declared in ((radians(1.0), "degrees", "rad"), (degrees(1.0), "rad", "deg")):
        if turning.any():
            yield Mistake(
                text=f"joints: the angles are in {found}, not in {declared}; correct their unit "
                "where they are imported",
                change=partial(Trial.reread, position=np.where(turning, factor, 1.0)),
            )
        if config.imu.present:
            yield Mistake(
                text=f"imu: its rates are in {found}/s, not in {declared}/s; correct their unit "
                "where they are imported",
                change=partial(Trial.turned, channels=[GYRO], M=factor * np.eye(3)),
            )
    for factor, found, declared in ((1e-3, "mm", "m"), (1e3, "m", "mm")):
        if not turning.all():
            yield Mistake(
                text=f"joints: the positions of prismatic joints are in {found}, not in "
                f"{declared}; correct their unit where they are imported",
                change=partial(Trial.reread, position=np.where(turning, 1.0, factor)),
            )
    for factor, found in ((1e-3, "1000 times too large"), (1e3, "1000 times too small")):
        if config.joints:
            yield Mistake(
                text=f"joints: the torques are {found}; correct their unit (N m, mN m; of "
                "prismatic joints N, mN) where they are imported",
                change=partial(Trial.reread, torque=factor),
            )
    g = STANDARD_GRAVITY_M_S2
    for factor, found, declared in ((g, "g", "m/s2"), (1.0 / g, "m/s2", "g")):
        if config.imu.present:
            yield Mistake(
                text=f"imu: its specific force is in {found}, not in {declared}; correct its unit "
                "where it is imported",
                change=partial(Trial.turned, channels=[ACCELEROMETER], M=factor * np.eye(3)),
            )


def _clocks(config: Config) -> Iterator[Mistake]:
    """Yield a shift of each source against all others; the buses come last."""
    sources = {"imu": [GYRO, ACCELEROMETER]} if config.imu.present else {}
    for bus in config.buses:
        own = [f"joints.{k}" for k, joint in enumerate(config.joints) if joint.bus == bus.name]
        if own:
            sources[f"bus {bus.name}"] = own
    periods_s = {
        f"bus {bus.name}": 1.0 / bus.rate_hz
        for bus in config.buses
        if any(joint.bus == bus.name and joint.driver == "described" for joint in config.joints)
    }
    if len(sources) < 2:
        sources = {}
    elif len(config.buses) == 1:
        del sources[f"bus {config.buses[0].name}"]  # the same as a shift of the inertial unit
    for name, channels in sources.items():
        yield Mistake(
            text=f"{name}: its clock differs from that of the other sources: add {{size}} s to its "
            f"stamps (fsw import --shift {name.rpartition(' ')[2]}={{size}}), or correct its delay",
            change=partial(_shifted, channels=channels),
            sizes=SHIFTS_S,
            periods_s=periods_s,
        )
    if config.joints:
        yield Mistake(
            text="joints: stamps of torques and positions differ, add {size} s to those of the "
            "torques; are they recorded by two sources, or filtered? torque_delay_sigma_s makes it "
            "a state",
            change=torques_shifted,
            sizes=SHIFTS_S,
            periods_s=periods_s,
        )


def _shifted(trial: Trial, by_s: float, channels: Sequence[str]) -> Trial:
    return trial.shifted(channels, by_s)


def torques_shifted(trial: Trial, by_s: float) -> Trial:
    """Return the trial with `by_s` added to the stamps of all torques."""
    shifted = {}
    for k in range(len(trial.config.joints)):
        own = trial.streams[f"joints.{k}"]
        torque = own.shifted(by_s).at(own.t_ns)[:, 1]
        shifted[f"joints.{k}"] = type(own)(own.t_ns, np.column_stack([own.values[:, 0], torque]))
    return trial.sampled(shifted)


def _gravity(config: Config) -> Iterator[Mistake]:
    down = np.array(config.base.gravity_B_m_s2)
    size = float(np.linalg.norm(down))
    if not size:
        return
    ways = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    for way in [-down / size, *ways]:
        if way @ down > 0.99 * size or (
            config.base.motion == "planar" and way @ down > -0.99 * size
        ):
            continue
        gravity = (size * way + 0.0).tolist()
        opposite = "points the other way" if way @ down < -0.99 * size else "has another direction"
        yield Mistake(
            text=f"base.gravity_B_m_s2: gravity {opposite}; set it to "
            f"[{', '.join(f'{v:.6g}' for v in gravity)}]",
            change=partial(_with_gravity, gravity=gravity),
        )


def _with_gravity(trial: Trial, gravity: Sequence[float]) -> Trial:
    base = trial.config.base.model_copy(update={"gravity_B_m_s2": tuple(gravity)})
    return trial.configured(base=base)


def _friction(config: Config) -> Iterator[Mistake]:
    bare = [k for k, j in enumerate(config.joints) if j.torque != "none" and not _rubs(config, k)]
    if bare:
        yield Mistake(
            text="joints: friction that is not declared; set "
            + " and ".join(_friction_keys(config)),
            change=partial(_with_friction, places=bare),
        )


def _friction_keys(config: Config) -> list[str]:
    """Return the keys of friction that the joints have in their configuration."""
    values = dict.fromkeys(("friction_coulomb_sigma_nm", "friction_viscous_sigma_nms_rad"))
    return list(dict.fromkeys(key for joint in config.joints for key in joint.named(values)))


def _motors(config: Config) -> Iterator[Mistake]:
    bare = [k for k, j in enumerate(config.joints) if j.torque == "link_side"]
    if any(not config.joints[k].rotor_inertia_sigma_kg_m2 for k in bare):
        yield Mistake(
            text="joints: the torques are those of the motors, not of the links; set torque: "
            "motor_current",
            change=partial(_as_of_motors, places=bare),
        )


def _as_of_motors(trial: Trial, places: Sequence[int]) -> Trial:
    """Return the trial with the wide priors of what stands between motor and link."""
    joints = list(trial.config.joints)
    for k in places:
        wide = {key: share * joints[k].torque_limit_nm for key, share in OF_MOTOR_CURRENT.items()}
        wide |= {
            "friction_load_sigma_ratio": LOAD_OF_CURRENT,
            "torque_scale_sigma_ratio": GAIN_OF_CURRENT,
        }
        joints[k] = joints[k].model_copy(update={**wide, "torque": "motor_current"})
    return trial.configured(joints=tuple(joints))


def _rubs(config: Config, k: int) -> bool:
    joint = config.joints[k]
    return joint.friction_coulomb_sigma_nm > 0.0 and joint.friction_viscous_sigma_nms_rad > 0.0


def _with_friction(trial: Trial, places: Sequence[int]) -> Trial:
    joints = list(trial.config.joints)
    for k in places:
        own = trial.streams[f"joints.{k}"]
        coulomb_nm = FRICTION_SHARE * float(np.sqrt(np.nanmean(own.values[:, 1] ** 2)))
        viscous = coulomb_nm / max(own.speed(), LEAST_SPEED)
        sigmas = {
            "friction_coulomb_sigma_nm": coulomb_nm,
            "friction_viscous_sigma_nms_rad": viscous,
        }
        joints[k] = joints[k].model_copy(update=sigmas)
    return trial.configured(joints=tuple(joints))


def _mountings(config: Config) -> Iterator[Mistake]:
    q = np.array(config.imu.mounting.q_BS_xyzw)
    R = rotation_from_xyzw(q)
    named = {
        f"{QUATERNION}: is that of B to S; its inverse takes S to B": R.T,
        f"{QUATERNION}: is in the order w x y z; must be x y z w": rotation_from_xyzw(
            q[[1, 2, 3, 0]]
        ),
    }
    for words, turn in _quarter_turns():
        named[f"{QUATERNION}: the unit's axes {words} stand where x y z should"] = R @ turn
    for text, true in named.items():
        if not np.allclose(true, R):
            values = Rotation.from_matrix(true).as_quat() + 0.0
            yield Mistake(
                text=f"{text}. Set q_BS_xyzw: [{', '.join(f'{v:.6g}' for v in values)}]",
                change=partial(_mounted, q_BS_xyzw=values.tolist()),
            )


def _quarter_turns() -> Iterator[tuple[str, FloatArray]]:
    """Yield the axes that stand where x y z should, and the rotation, of all but the identity."""
    for axes, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        turn = np.diag(signs)[list(axes)]
        if np.linalg.det(turn) > 0 and not np.allclose(turn, np.eye(3)):
            words = [f"{'-' if turn[row].sum() < 0 else ''}{'xyz'[axes[row]]}" for row in range(3)]
            yield " ".join(words), np.asarray(turn, np.float64)


def _wrenches(config: Config) -> Iterator[Mistake]:
    """Yield sign and quarter turns of every wrench sensor."""
    for i, sensor in enumerate(config.wrench_sensors):
        key, channels = f"wrench_sensors.{i}", [f"wrench_sensors.{i}"]
        R_FS = Rotation.from_euler("xyz", sensor.rpy_FS_rad)
        yield Mistake(
            text=f"{key}.sign ({sensor.name}): {sensor.sign} should be {-sensor.sign}",
            change=partial(Trial.turned, channels=channels, M=-np.eye(6)),
        )
        for words, turn in _quarter_turns():
            true = (R_FS * Rotation.from_matrix(turn)).as_euler("xyz") + 0.0
            yield Mistake(
                text=f"{key}.rpy_FS_rad ({sensor.name}): its axes {words} stand where x y z "
                f"should; set it to [{', '.join(f'{v:.6g}' for v in true)}]",
                change=partial(Trial.turned, channels=channels, M=block_diag(turn, turn)),
            )


def _mounted(trial: Trial, q_BS_xyzw: Sequence[float]) -> Trial:
    imu = trial.config.imu
    mounting = imu.mounting.model_copy(update={"q_BS_xyzw": tuple(q_BS_xyzw)})
    return trial.configured(imu=imu.model_copy(update={"mounting": mounting}))


def _axes() -> Iterator[Mistake]:
    """Yield signs and exchanges of the axes of one of the two sensors of an inertial unit."""
    ways: dict[str, FloatArray] = {"counts the other way": -np.eye(3)}
    for k, axis in enumerate("xyz"):
        ways[f"counts the other way in {axis}"] = np.diag(np.where(np.arange(3) == k, -1.0, 1.0))
    for i, k in combinations(range(3), 2):
        places = [0, 1, 2]
        places[i], places[k] = k, i
        ways[f"has {'xyz'[i]} and {'xyz'[k]} exchanged"] = np.eye(3)[places]
    for name, channel in (("gyro", GYRO), ("accelerometer", ACCELEROMETER)):
        for words, M in ways.items():
            why = (
                " (gravity, not specific force)"
                if (name, words[-3:]) == ("accelerometer", "way")
                else ""
            )
            yield Mistake(
                text=f"imu: its {name} {words}{why}",
                change=partial(Trial.turned, channels=[channel], M=M),
            )
