"""Try the usual mistakes of a configuration on recorded blocks, to find one that explains the data.

Examples are a wrong sign, two swapped joints, a rotated sensor. For each mistake, the blocks are
changed to those of a correct configuration, and the bodies are identified again. Residuals as small
as the declared noise show the actual mistake; hardly any other mistake leaves such residuals.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsw.checks.mounting import (
    contradicted,
    mounting_words,
    other_words,
    with_doubtful_mounting,
    with_free_mounting,
)
from fsw.config import Config
from fsw.estimators.batch.solver import Target, minimise
from fsw.estimators.measurement.row_functions import Linearisation, row_function
from fsw.estimators.model.building import body_prior, build_problem, joint_order
from fsw.estimators.model.inertia import PARAMETERS, from_parameters
from fsw.estimators.model.problem import Problem
from fsw.estimators.rotation import rotation_from_xyzw
from fsw.messages import Block, FloatArray
from fsw.messages.errors import NUMERICAL, ConfigError

BLOCKS = 8  # number of blocks used, spread over the recording
ITERATIONS = 12
LARGE = 3.0  # ratio of squared residuals to declared noise above which something is wrong
EXPLAINED = 0.1  # largest share of the squared residuals that remains if a mistake explains them
TOLD = 10  # mistakes between two lines of progress
WELL_EXPLAINED = 9.0  # largest ratio of squared residuals to noise after the found mistakes
AT_ONCE = 3  # most mistakes searched for in one configuration
FREED, FREED_M = 30.0, 3.0  # sigma of a freed base: ratio for mass and inertia; centre of mass
FREED_ITERATIONS = 60

Change = Callable[[Block], Block]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mistake:
    """A possible mistake; `change` returns a block as it would be without the mistake."""

    text: str  # states which key must change
    change: Change


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Ratio of squared residuals to declared noise, and the mistakes that explain the ratio."""

    before: float  # ratio with the configuration as it is
    after: float  # ratio after the changes in `found` or `nearest`
    found: tuple[str, ...]  # changes of the configuration that explain the data, in order found
    nearest: tuple[str, ...]  # changes that help most, if they do not explain the data
    tried: int
    mounting: str  # fault of the inertial unit's place or attitude; empty: both fit
    doubtful: str  # another value of arm or calibration far from its prior; empty: none


def explain_residuals(
    config: Config, problem: Problem, blocks: Sequence[Block], progress: Callable[[str], None]
) -> Verdict:
    """Return the mistakes that explain large residuals; search them one after the other."""
    moving = [block for block in blocks if np.abs(block.qd_rad_s).max() > 0.0]
    usable = moving or blocks  # static poses show signs and order by weight alone
    places = np.linspace(0, len(usable) - 1, min(BLOCKS, len(usable))).round().astype(int)
    chosen = [usable[k] for k in places]
    before = level = residual_level(problem, chosen)
    candidates, found = usual_mistakes(config, problem), list[str]()
    while level > LARGE and len(found) < AT_ONCE:
        progress(f"residuals {level**0.5:.3g} times the noise: trying {len(candidates)} mistakes")
        levels = list[float]()
        for candidate in candidates:
            levels.append(residual_level(problem, [candidate.change(b) for b in chosen]))
            if len(levels) % TOLD == 0:
                progress(f"{len(levels)} of {len(candidates)} tried")
        best = int(np.argmin(levels))
        if levels[best] > EXPLAINED * level:
            break
        chosen, level = [candidates[best].change(b) for b in chosen], levels[best]
        found.append(candidates[best].text)
    mounting = doubtful = ""
    if not found:
        left, mounting, doubtful = _doubted(config, problem, usable, level)
        level, found = (left, [mounting]) if level > LARGE and mounting else (level, found)
    if not found and level > LARGE and "base" not in config.unknown:
        progress("trying another base")
        freed, words = _freed_base(config, problem, chosen)
        if freed <= LARGE:
            level, found = freed, [words]
    names, tried, explained = tuple(found), len(candidates), level <= WELL_EXPLAINED
    return Verdict(
        before=before,
        after=level,
        found=names if explained else (),
        nearest=() if explained else names,
        tried=tried,
        mounting=mounting,
        doubtful=doubtful,
    )


def _doubted(
    config: Config, problem: Problem, blocks: Sequence[Block], level: float
) -> tuple[float, str, str]:
    """Return ratio and words on mounting and other values; a wrong mounting is estimated freely."""
    problem = with_doubtful_mounting(config, problem)
    x = _fit(problem, blocks)[1]
    kind = contradicted(problem, x)
    if config.imu.present and (level > LARGE or kind in ("imu_place", "imu_angle")):
        left, freed = _fit(with_free_mounting(problem), blocks, FREED_ITERATIONS)
        words = mounting_words(config, problem, freed) if left <= LARGE else ""
        if words:
            return left, words, ""
    return level, "", other_words(problem, x) if kind and level <= LARGE else ""


def residual_level(problem: Problem, blocks: Sequence[Block]) -> float:
    """Return the ratio of squared residuals of the best fit to declared noise; inf: no fit."""
    return _fit(problem, blocks)[0]


def _fit(
    problem: Problem, blocks: Sequence[Block], iterations: int = ITERATIONS
) -> tuple[float, FloatArray]:
    """Return the ratio as `residual_level` does, and the state (p,) of the best fit."""
    nothing = float("inf"), problem.prior_mean
    if not blocks:
        return nothing
    target = Target(Linearisation(row_function("fused", "eiv", problem), blocks))
    try:
        with np.errstate(all="ignore"):
            solution = minimise(problem, target, max_iterations=iterations, plain=False)
    except NUMERICAL:
        return nothing
    level = solution.cost / max(solution.rows, 1)
    return (level, solution.mean) if np.isfinite(level) else nothing


def _freed_base(config: Config, problem: Problem, blocks: Sequence[Block]) -> tuple[float, str]:
    """Return the ratio left if the known base is estimated, and words on the base found."""
    own = config.bodies.get("base")
    key = "the URDF's root link" if own is None else "bodies.base"
    pi = problem.model.pi_links[:PARAMETERS] if own is None else body_prior(own)[0]
    mass_kg, com_m, inertia = from_parameters(pi)
    largest = float(max(inertia[k] for k in (0, 3, 5)))
    base = {
        "mass_kg": float(mass_kg),
        "com_m": com_m.tolist(),
        "inertia_kg_m2": inertia.tolist(),
        "sigma": {
            "mass_kg": FREED * float(mass_kg),
            "com_m": [FREED_M] * 3,
            "inertia_kg_m2": [FREED * largest] * 6,
        },
    }
    bodies = {name: body.model_dump() for name, body in config.bodies.items()} | {"base": base}
    try:
        freed = config.with_sections(bodies=bodies, unknown=("base", *config.unknown))
        wider = build_problem(freed, problem.model)
    except ConfigError:  # such as for a clamped base
        return float("inf"), ""
    level, x = _fit(wider, blocks, FREED_ITERATIONS)
    found_kg = x[wider.body("base")][0]
    return level, (
        f"the known base ({key}): its data do not fit; mass {mass_kg:.4g} kg, found about "
        f"{found_kg:.3g} kg. Correct it, or estimate it: base under unknown"
    )


def usual_mistakes(config: Config, problem: Problem) -> list[Mistake]:
    """Return the mistakes to try for the joints and the inertial unit of a configuration."""
    of_imu = _imu_mistakes(config) if config.imu.present else []
    return [*_joint_mistakes(config, problem), *of_imu]


def _joint_mistakes(config: Config, problem: Problem) -> list[Mistake]:
    order = joint_order(config, problem.model)
    joints = [config.joints[k] for k in order]
    columns = _Readings(
        sign=np.array([float(joint.sign) for joint in joints]),
        zero_rad=np.array([joint.zero_offset_rad for joint in joints]),
        gain=np.array([joint.torque_gain for joint in joints]),
        offset_nm=np.array([joint.torque_offset_nm for joint in joints]),
    )
    found = []
    for k, joint in enumerate(joints):
        key, turned = f"joints.{order[k]}", np.ones(len(joints))
        turned[k] = -1.0
        found += [
            Mistake(
                text=f"{key}.sign ({joint.name}): {joint.sign} should be {-joint.sign}",
                change=partial(columns.changed, sign=turned, torque_sign=turned),
            ),
            Mistake(
                text=f"{key} ({joint.name}): its torque alone counts the other way (proximal "
                f"side, or mounted reversed); set {key}.torque_gain to {-joint.torque_gain:g}",
                change=partial(columns.changed, sign=np.ones(len(joints)), torque_sign=turned),
            ),
        ]
    for i, k in combinations(range(len(joints)), 2):
        swapped = np.arange(len(joints))
        swapped[[i, k]] = k, i
        found.append(
            Mistake(
                text=f"joints.{order[i]}.node_id and joints.{order[k]}.node_id ({joints[i].name}, "
                f"{joints[k].name}): swapped",
                change=partial(columns.reordered, places=swapped),
            )
        )
    return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Readings:
    """Calibration (n,) from readings of the nodes to angles and torques, in the model's order."""

    sign: FloatArray
    zero_rad: FloatArray
    gain: FloatArray
    offset_nm: FloatArray

    def changed(self, block: Block, sign: FloatArray, torque_sign: FloatArray) -> Block:
        """Return the block with the readings reversed where `sign` or `torque_sign` (n,) is -1."""
        return replace(
            block,
            q_rad=sign * (block.q_rad + self.zero_rad) - self.zero_rad,
            qd_rad_s=sign * block.qd_rad_s,
            qdd_rad_s2=sign * block.qdd_rad_s2,
            tau_nm=torque_sign * (block.tau_nm + self.offset_nm) - self.offset_nm,
        )

    def reordered(self, block: Block, places: NDArray[np.int64]) -> Block:
        """Return a block in which joint k has the readings of joint `places[k]`, places (n,)."""
        sense = self.sign * self.sign[places]
        scale = sense * self.gain / self.gain[places]
        return replace(
            block,
            q_rad=sense * (block.q_rad + self.zero_rad)[:, places] - self.zero_rad,
            qd_rad_s=sense * block.qd_rad_s[:, places],
            qdd_rad_s2=sense * block.qdd_rad_s2[:, places],
            tau_nm=scale * (block.tau_nm + self.offset_nm)[:, places] - self.offset_nm,
            has_joint=block.has_joint[places],
        )


def _imu_mistakes(config: Config) -> list[Mistake]:
    q = np.array(config.imu.mounting.q_BS_xyzw)
    R = rotation_from_xyzw(q)
    key = "imu.mounting.q_BS_xyzw"
    named = {
        f"{key}: is that of B to S; its inverse takes S to B": R.T,
        f"{key}: is in the order w x y z; must be x y z w": rotation_from_xyzw(q[[1, 2, 3, 0]]),
    }
    for axes, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        turn = np.diag(signs)[list(axes)]
        if np.linalg.det(turn) > 0 and not np.allclose(turn, np.eye(3)):
            words = [f"{'-' if turn[row].sum() < 0 else ''}{'xyz'[axes[row]]}" for row in range(3)]
            text = f"{key}: the unit's axes {' '.join(words)} stand where x y z should"
            named[text] = R @ turn
    found = [
        Mistake(
            text=f"{text}. Set q_BS_xyzw: {_quaternion(true)}",
            change=partial(_turned, turn=true @ R.T),
        )
        for text, true in named.items()
        if not np.allclose(true, R)
    ]
    return [
        *found,
        Mistake(
            text="imu: its accelerometer counts the other way (gravity, not specific force)",
            change=lambda block: replace(block, f_NS_B_m_s2=-block.f_NS_B_m_s2),
        ),
        Mistake(
            text="imu: its gyro counts the other way",
            change=lambda block: replace(
                block, w_NB_B_rad_s=-block.w_NB_B_rad_s, wd_NB_B_rad_s2=-block.wd_NB_B_rad_s2
            ),
        ),
    ]


def _quaternion(R: FloatArray) -> str:
    return f"[{', '.join(f'{v + 0.0:.6g}' for v in Rotation.from_matrix(R).as_quat())}]"


def _turned(block: Block, turn: FloatArray) -> Block:
    return replace(
        block,
        w_NB_B_rad_s=block.w_NB_B_rad_s @ turn.T,
        wd_NB_B_rad_s2=block.wd_NB_B_rad_s2 @ turn.T,
        f_NS_B_m_s2=block.f_NS_B_m_s2 @ turn.T,
    )
