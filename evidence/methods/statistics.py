"""Figures of one method over the seeds: errors over bounds with intervals, NEES with its band."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from evidence.methods.cases import StudyRecord
from hil.judge import chi_square
from hil.world.inertia import FloatArray

CONFIDENCE = 0.95
RESAMPLES = 2000  # of the bootstrap
FEW = 10  # with fewer seeds, intervals come from chi-square
BIAS_LEVEL = 1e-3  # level of Hotelling's test of a zero mean error


@dataclass(frozen=True, slots=True)
class EfficiencyRatio:
    """A root-mean-square ratio with the ends of its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Figures:
    """Statistics of a method over the seeds; a ratio is a root-mean-square whitened error.

    `overall` and `groups` are whitened by the bound of all channels, `own_overall` and `own_groups`
    by the bound of the method's own channels.
    """

    seeds: int
    failed: int  # seeds without a result
    not_ok: int  # seeds with a status other than OK, failures included
    dof: int  # number of parameters
    overall: EfficiencyRatio
    own_overall: EfficiencyRatio
    groups: Mapping[str, EfficiencyRatio]
    own_groups: Mapping[str, EfficiencyRatio]
    median: float  # over seeds, of one seed's root-mean-square whitened error
    worst: float
    worst_seed: int
    nees: float  # mean over seeds
    nees_low: float  # 95 % band of the mean of chi-square with dof degrees of freedom
    nees_high: float
    nees_tail: float  # two-sided probability of a mean as far off as `nees`
    nees_median: float
    biased: Mapping[str, float]  # group -> largest mean error in sigmas of the bound


def figures(
    records: Sequence[StudyRecord],
    bounds: Sequence[FloatArray],
    own_bounds: Sequence[FloatArray],
    groups: Mapping[str, slice],
) -> Figures:
    """Return the figures of one method; bounds (p, p) are covariances, one for each record.

    The interval of a ratio is a bootstrap over the independent seeds (percentiles of 2000
    resamples), valid for heavy tails and errors correlated within a seed. For fewer than ten seeds
    it is an interval from chi-square, valid for Gaussian errors.
    """
    kept = [k for k, record in enumerate(records) if record.error is not None]
    dof = max(group.stop for group in groups.values())
    nees = np.array([records[k].nees for k in kept])
    errors = np.array([records[k].error for k in kept]).reshape(len(kept), dof)
    whole = slice(0, dof)
    used, own_used = [bounds[k] for k in kept], [own_bounds[k] for k in kept]
    squares = _squares(errors, used, whole)
    worst = int(np.argmax(squares)) if kept else -1
    low, high = chi_square.mean_ends(dof, len(kept)) if kept else (np.nan, np.nan)
    below = float(stats.chi2.cdf(nees.sum(), dof * len(kept))) if kept else float("nan")
    return Figures(
        seeds=len(records),
        failed=len(records) - len(kept),
        not_ok=sum(record.status != "OK" for record in records),
        dof=dof,
        overall=ratio(squares, dof),
        own_overall=ratio(_squares(errors, own_used, whole), dof),
        groups={g: ratio(_squares(errors, used, k), width(k)) for g, k in groups.items()},
        own_groups={g: ratio(_squares(errors, own_used, k), width(k)) for g, k in groups.items()},
        median=float(np.sqrt(np.median(squares))) if kept else float("nan"),
        worst=float(np.sqrt(squares[worst])) if kept else float("nan"),
        worst_seed=records[kept[worst]].key.seed if kept else -1,
        nees=float(nees.mean()) if kept else float("nan"),
        nees_low=low,
        nees_high=high,
        nees_tail=2.0 * min(below, 1.0 - below),
        nees_median=float(np.median(nees)) if kept else float("nan"),
        biased=_biased(errors, used, groups),
    )


def _squares(errors: FloatArray, bounds: Sequence[FloatArray], group: slice) -> FloatArray:
    """Return (k,) e_g^T C_gg^-1 e_g / dim for every error; C_gg is the group's marginal bound."""
    values = []
    for error, bound in zip(errors, bounds, strict=True):
        C, e = bound[group, group], error[group]
        scale = np.sqrt(np.diag(C))
        L = np.linalg.cholesky(C / np.outer(scale, scale))
        z = np.linalg.solve(L, e / scale)
        values.append(float(z @ z) / e.size)
    return np.array(values)


def width(group: slice) -> int:
    """Return the number of parameters of a group."""
    return int(group.stop - group.start)


def ratio(squares: FloatArray, dof: int) -> EfficiencyRatio:
    """Return the root of the mean of (k,) squares per degree of freedom, with its interval."""
    if squares.size == 0:
        return EfficiencyRatio(float("nan"), float("nan"), float("nan"))
    if squares.size < FEW:
        value = float(np.sqrt(squares.mean()))
        total = dof * squares.size
        low, high = chi_square.ends(total)
        return EfficiencyRatio(value, value * (total / high) ** 0.5, value * (total / low) ** 0.5)
    rng = np.random.default_rng(0)
    picks = rng.integers(0, squares.size, (RESAMPLES, squares.size))
    means = np.sqrt(squares[picks].mean(axis=1))
    low, high = np.quantile(means, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2])
    return EfficiencyRatio(float(np.sqrt(squares.mean())), float(low), float(high))


def _biased(
    errors: FloatArray, bounds: Sequence[FloatArray], groups: Mapping[str, slice]
) -> dict[str, float]:
    """Return the groups with a mean error that is not zero, and its largest component over sigma.

    The test is Hotelling's T-square on the scatter of the errors, at a level of 0.1 %.
    """
    found = {}
    count = len(errors)
    for name, k in groups.items():
        d = width(k)
        if count < d + 5:
            continue
        scale = np.sqrt(np.mean([np.diag(bound)[k] for bound in bounds], axis=0))
        e = errors[:, k] / scale
        mean = e.mean(axis=0)
        spread = np.atleast_2d(np.cov(e, rowvar=False))
        size = np.sqrt(np.diag(spread))
        if not np.all(size > 0):
            continue
        unit = mean / size
        T2 = count * float(unit @ np.linalg.solve(spread / np.outer(size, size), unit))
        F = (count - d) / (d * (count - 1)) * T2
        if stats.f.sf(F, d, count - d) < BIAS_LEVEL:
            found[name] = float(mean[np.argmax(np.abs(mean))])
    return found
