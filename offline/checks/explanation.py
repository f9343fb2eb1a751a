"""Find the mistakes that explain why recorded data do not fit a configuration.

For each usual mistake the samples or the configuration are changed to those without it, and the
bodies are identified again. Residuals as small as the noise show the actual mistake; hardly any
other mistake leaves such residuals. Where several leave equally small ones, all are named.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from fsw.config import Config
from fsw.errors import ConfigError
from fsw.estimators.model.building import body_prior, build_problem
from fsw.estimators.model.inertia import PARAMETERS, from_parameters
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from offline.checks.mistake import SHIFTS_S, Mistake
from offline.checks.mistakes import signs, usual_mistakes
from offline.checks.mounting import (
    MOUNTING,
    contradicted,
    mounting_words,
    other_words,
    with_doubtful_mounting,
    with_free_mounting,
)
from offline.checks.trial import ITERATIONS, Fit, Trial, fitted

LARGE = 3.0  # ratio of squared residuals to declared noise above which something is wrong
EXPLAINED = 0.1  # largest share of the excess over noise that remains if a mistake explains it
HELPS = 0.5  # share of the excess below which a sensor that is left out may be one of the causes
ALIKE = 1.5  # ratio of excesses over noise of two mistakes that explain the data equally well
MOST_ALIKE = 3
OR = "; or: "
SHOWN = 20  # mistakes between two lines of progress
WELL_EXPLAINED = 9.0  # largest ratio of squared residuals to noise after the found mistakes
AT_ONCE = 3  # most mistakes searched for in one configuration
FREED, FREED_M = 30.0, 3.0  # sigma of a freed base: ratio for mass and inertia; centre of mass
FREED_ITERATIONS = 60
FEW_PLACES, FEW_ITERATIONS = 3, 5  # at which all mistakes are compared ...
CANDIDATES = 8  # ... of which the best ones are tried at all places
LEAST_OFFSET_S, OFFSET_GAIN = 4e-3, 60.0  # least shift of a clock, and its least gain
DOUBTFUL_GAIN, LEAST_LEVEL = 30.0, 1e-9  # least gain by another sign, and least level for it
SIZE_TOLERANCE, SIZINGS = 2e-4, 15  # of the search for the best size ...
FEW_SIZINGS = 8  # ... and before the best mistakes are chosen
UNFIT = 1e30  # stands for no fit in that search


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Ratio of squared residuals to noise, and the mistakes that explain the ratio."""

    before: float  # ratio with the configuration as it is
    after: float  # ratio after the changes in `found` or `nearest`
    found: tuple[str, ...]  # mistakes that explain the data, in order found
    nearest: tuple[str, ...]  # mistakes that help most, if they do not explain the data
    tried: int
    mounting: str  # fault of the inertial unit's place or attitude; empty: both fit
    doubtful: str  # another value of arm or calibration far from its prior; empty: none
    is_sign: bool = False  # whether `found` is a sign at which small residuals are still smaller


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Tried:
    """A mistake without which the trial fits as `level` says."""

    mistake: Mistake
    size: float  # 0 for a mistake that has none
    level: float
    trial: Trial

    @property
    def text(self) -> str:
        """The words of the mistake, with its size."""
        return self.mistake.words(self.size)


def explain_residuals(
    trial: Trial, blocks: Sequence[Block], progress: Callable[[str], None]
) -> Verdict:
    """Return the mistakes that explain large residuals; search them one after the other.

    `blocks` are all blocks of the recording.
    """
    fit = trial.fit(FREED_ITERATIONS, plain=True)  # if not settled, it would look wrong
    before, config = fit.level, trial.config
    found, nearest, level, count = _searched(trial, before, progress)
    likelier, is_sign = "", False
    if before <= LARGE and not (found := _small_offset(trial, fit)):
        found, likelier = _likelier_sign(trial, fit)
        is_sign = bool(found)
    mounting = doubtful = ""
    if not found:
        left, mounting, doubtful = _doubted(config, trial.problem, blocks, before)
        if before > LARGE and mounting:
            level, found = left, [mounting]
    if not found and before > LARGE and "base" not in config.unknown:
        progress("trying another base")
        freed, words = _freed_base(trial)
        if freed <= LARGE:
            level, found = freed, [words]
    return Verdict(
        before=before,
        after=level,
        found=tuple(found),
        nearest=() if found else tuple(name.partition(OR)[0] for name in nearest),
        tried=count,
        mounting=mounting,
        doubtful=doubtful or likelier,
        is_sign=is_sign,
    )


def _searched(
    trial: Trial, level: float, progress: Callable[[str], None]
) -> tuple[list[str], list[str], float, int]:
    """Return mistakes that explain the data, or that help most; the ratio left; number tried."""
    groups, count = list[list[_Tried]](), 0
    while level > LARGE and len(groups) < AT_ONCE:
        count, tried = _tried(trial, level, progress)
        best = min(tried, key=lambda own: own.level)
        if _excess(best.level) > EXPLAINED * _excess(level):
            break
        most = ALIKE * max(best.level, 1.0)
        alike = sorted((own for own in tried if own.level <= most), key=lambda own: own.level)
        groups.append(alike[:MOST_ALIKE])
        trial, level = best.trial, best.level
    words = _words(groups)
    return (words, [], level, count) if level <= WELL_EXPLAINED else ([], words, level, count)


def _words(groups: Sequence[Sequence[_Tried]]) -> list[str]:
    """Return the words of each group of alike mistakes, the sizes of a repeated one as one sum."""
    sizes: dict[str, float] = {}
    for best, *_ in groups:
        sizes[best.mistake.text] = sizes.get(best.mistake.text, 0.0) + best.size
    words = []
    for best, *others in groups:
        if best.mistake.text in sizes:
            whole = replace(best, size=sizes.pop(best.mistake.text))
            words.append(OR.join(own.text for own in (whole, *others)))
    return words


def _small_offset(trial: Trial, fit: Fit) -> list[str]:
    """Return in words a clock's offset that residuals of the size of the noise show, if any.

    The squared residuals of a correct configuration fall by about 1 if a shift is freed.
    """
    shifts = [_sized(own, trial) for own in usual_mistakes(trial) if own.sizes is SHIFTS_S]
    best = min(shifts, key=lambda own: own.level, default=None)
    if best is None or abs(best.size) < LEAST_OFFSET_S:
        return []
    return [best.text] if fit.rows * (fit.level - best.level) > OFFSET_GAIN else []


def _excess(level: float) -> float:
    return max(level - 1.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Unexplained:
    """Ratio of squared residuals, and what it shows without a long search.

    Attributes
    ----------
    words : texts about a clock's offset if the residuals are small, otherwise about a sign
    one_sensor : whether the data may fit if one sensor is left out, here or elsewhere
    """

    level: float
    words: tuple[str, ...]
    one_sensor: bool


def unexplained(trial: Trial) -> Unexplained:
    """Return what the configuration leaves unexplained at the places of the trial."""
    fit = trial.fit(FREED_ITERATIONS, plain=True)
    if fit.level <= LARGE:
        return Unexplained(level=fit.level, words=tuple(_small_offset(trial, fit)), one_sensor=True)
    least = min(fitted(trial.problem, own).level for own in _without_one(trial))
    helps = _excess(least) < HELPS * _excess(fit.level)
    return Unexplained(level=fit.level, words=tuple(_signs(trial, fit.level)), one_sensor=helps)


def _without_one(trial: Trial) -> Iterator[list[Block]]:
    """Yield the blocks of a trial without one of the sensors."""
    for k in range(len(trial.blocks[0].has_joint) if trial.blocks else 0):
        others = np.arange(len(trial.blocks[0].has_joint)) != k
        yield [replace(own, has_joint=own.has_joint & others) for own in trial.blocks]
    yield [replace(own, has_accelerometer=False) for own in trial.blocks]
    yield [replace(own, has_gyro=False) for own in trial.blocks]


def _signs(trial: Trial, level: float) -> list[str]:
    """Return in words the wrong sign without which residuals are as small as noise, if any."""
    tried = _other_signs(trial)
    if not tried or tried[0].level > LARGE or _excess(tried[0].level) > EXPLAINED * _excess(level):
        return []
    return _words([[own for own in tried if own.level <= ALIKE * max(tried[0].level, 1.0)]])


def _other_signs(trial: Trial) -> list[_Tried]:
    """Return the trial with the signs that fit best, the best one first."""
    few = trial.thinned(FEW_PLACES)
    screened = [_without(own, few, 0.0, FEW_ITERATIONS) for own in signs(trial.config)]
    best = sorted(screened, key=lambda own: own.level)[:MOST_ALIKE]
    return sorted((_without(own.mistake, trial) for own in best), key=lambda own: own.level)


def _likelier_sign(trial: Trial, fit: Fit) -> tuple[list[str], str]:
    """Return texts about a sign that explains small residuals better: certain ones, a doubtful one.

    Wide priors, as those of friction, leave small residuals at a wrong sign of a light joint. No
    state is freed, so that the squared residuals of a correct configuration rise with any other.
    """
    tried = _other_signs(trial) if fit.level > LEAST_LEVEL else []
    gain = fit.rows * (1.0 - tried[0].level / fit.level) if tried else 0.0
    if gain <= DOUBTFUL_GAIN:
        return [], ""
    most = tried[0].level * (1.0 + DOUBTFUL_GAIN / fit.rows)
    words = OR.join(own.text for own in tried if own.level <= most)
    words += f" (residuals {(tried[0].level / fit.level) ** 0.5:.2f} times as large with it)"
    return ([words], "") if gain > OFFSET_GAIN else ([], words)


def _tried(trial: Trial, level: float, progress: Callable[[str], None]) -> tuple[int, list[_Tried]]:
    """Return how many mistakes were tried, and the trial without each of the best ones.

    The best ones are chosen at a few of the places.
    """
    mistakes, few = usual_mistakes(trial), trial.thinned(FEW_PLACES)
    progress(f"residuals {level**0.5:.3g} times the noise: trying {len(mistakes)} mistakes")
    screened: list[tuple[float, Mistake, float]] = []  # level, and the first size of the search
    for count, mistake in enumerate(mistakes, 1):
        tried = [_without(mistake, few, size, FEW_ITERATIONS) for size in mistake.sizes or (0.0,)]
        best = min(tried, key=lambda own: own.level)
        start = best.size
        if mistake.sizes:  # between two sizes the level may be far below that of both
            best = _sized(mistake, few, start, FEW_ITERATIONS, FEW_SIZINGS)
        screened.append((best.level, mistake, start))
        if count % SHOWN == 0:
            progress(f"{count} of {len(mistakes)} tried")
    chosen = sorted(screened, key=lambda own: own[0])[:CANDIDATES]
    return len(mistakes), [
        _sized(own, trial, start) if own.sizes else _without(own, trial) for _, own, start in chosen
    ]


def _without(
    mistake: Mistake, trial: Trial, size: float = 0.0, iterations: int = ITERATIONS
) -> _Tried:
    changed = mistake.change(trial, size) if mistake.sizes else mistake.change(trial)
    level = changed.fit(iterations).level
    return _Tried(mistake=mistake, size=size, level=level, trial=changed)


def _sized(
    mistake: Mistake,
    trial: Trial,
    start: float = 0.0,
    iterations: int = ITERATIONS,
    sizings: int = SIZINGS,
) -> _Tried:
    """Return the trial without a mistake of the size, near `start` of its sizes, that fits best."""
    sizes = mistake.sizes
    near = min(max(1, sizes.index(start)), len(sizes) - 2)
    tried = [_without(mistake, trial, start, iterations)]

    def level(size: float) -> float:
        tried.append(_without(mistake, trial, size, iterations))
        return min(tried[-1].level, UNFIT)

    bounds = sizes[near - 1], sizes[near + 1]
    minimize_scalar(level, bounds=bounds, options={"xatol": SIZE_TOLERANCE, "maxiter": sizings})
    return min(tried, key=lambda own: own.level)


def _doubted(
    config: Config, problem: Problem, blocks: Sequence[Block], level: float
) -> tuple[float, str, str]:
    """Return ratio, and in words wrong mounting and other values; a wrong mounting is estimated."""
    problem = with_doubtful_mounting(config, problem)
    fit = fitted(problem, blocks, FREED_ITERATIONS, plain=True)
    kind = contradicted(problem, fit.mean) if fit.has_settled else ""
    if config.imu.present and (level > LARGE or kind in MOUNTING):
        free = fitted(with_free_mounting(problem), blocks, FREED_ITERATIONS)
        words = mounting_words(config, problem, free.mean) if free.level <= LARGE else ""
        if words:
            return free.level, words, ""
    return level, "", other_words(problem, fit.mean) if kind and level <= LARGE else ""


def _freed_base(trial: Trial) -> tuple[float, str]:
    """Return the ratio left if the known base is estimated, and that base in words."""
    config, problem = trial.config, trial.problem
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
    fit = fitted(wider, trial.blocks, FREED_ITERATIONS)
    found_kg = fit.mean[wider.body("base")][0]
    return fit.level, (
        f"the known base ({key}): its data do not fit; mass {mass_kg:.4g} kg, found about "
        f"{found_kg:.3g} kg. Correct it, or estimate it: base under unknown"
    )
