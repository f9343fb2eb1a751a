"""Residuals that are alike from window to window: what this costs, and what it cannot explain.

Friction by load and angle, cables and gears leave torques that no state of the model explains. They
fade slowly, so that the windows hold less information than white noise would leave in them. With
whitened rows A and residuals b of one kind of rows c (a joint, an axis of a sensor), in the order
of time, the score A^T b of an estimate has the long-run covariance

    S = sum over c of A_c^T T_c A_c

where the Toeplitz matrix T_c holds the autocovariance of the residuals b_c over the whole
recording, tapered by Parzen's window. The covariance of the estimate is P S P with the prior's part
(a sandwich), and never smaller than P in any direction. White residuals give S = A^T A. Kinds of
rows whose residuals fade alike share their fading. The sigma that follows from so few independent
samples is widened to that of Student's distribution.

Only torques of a held arm may be alike: in an inertial unit nothing fades so slowly but its bias, a
state of its own. Where an arm repeats its motion, its residuals repeat too, and repetitions add
nothing: then the autocovariance is used at all lags, without taper. Other residuals that are noise
do not resemble those half a recording later. Two halves of the data agree within this covariance;
those of a wrong model need not.
Source: Newey, West, Econometrica 55 (1987) 703; Priestley, Spectral Analysis and Time Series
(1981), 6.2.3 (Parzen's window) and table 6.2 (its equivalent degrees of freedom).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft
from scipy.special import chdtri

from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.model.state_groups import in_words as state_in_words
from fsw.estimators.noise.few_windows import student
from fsw.messages import Block, FloatArray

LONGEST = 0.25  # longest lag of the autocovariance, as a share of the recording
DOF = 3.71 / LONGEST  # equivalent degrees of freedom of a long-run variance, Parzen's window
CONTRADICTION = 1e-6  # probability that two halves of data with a correct model disagree so much
LASTING_SIGMAS = 4.9  # of the correlation over half a recording: once in a million recordings
LASTING = 0.03  # least correlation that counts, as in `recursive.change.colour`
MOST_LASTING = 0.7  # correlation that counts however few samples are independent
LOUD = 9.0  # squared residual over noise above which a wrench sensor's axes are judged apart
KNOWN = 0.02  # least variance of a direction's score that the comparison of halves counts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Likeness:
    """How much residuals that are alike widen sigma, and whether two halves of the data agree.

    Attributes
    ----------
    excess : (p, p) long-run covariance of the score beyond the information of white residuals
    halves : squared whitened difference of two halves of the data, and its limit
    """

    excess: FloatArray
    halves: tuple[float, float]


def likeness(
    jacobians: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    covariance: FloatArray,
    level: float,
    nodes: int,
    edges: Sequence[int] = (),
    *,
    repeats: bool = False,
) -> Likeness:
    """Return how much residuals that are alike widen an estimate's sigma, and if halves agree.

    Parameters
    ----------
    jacobians, residuals : whitened rows A (m, p) and b (m,) per block, oldest first; blocks with
        fewer rows than most, where a channel was missing, count as white
    covariance : (p, p) of the estimate if the residuals were white
    level : ratio of the noise's variance to the declared one
    nodes : number of nodes per block. The rows of a node stand together, in the same order at
        each node. Where their number is not a multiple of `nodes`, each row is a kind of its own
    edges : per block how many of its last rows are of its edge; each of them is a kind of its own
    repeats : whether residuals repeat with the motion; then products of any lag are counted
    """
    edges = edges or [0] * len(residuals)
    scale = level**-0.5
    inner = [len(rows) - edge for rows, edge in zip(residuals, edges, strict=True)]
    size, most = max(inner), max(edges)
    kinds = [([k for k, own in enumerate(inner) if own == size], slice(size), nodes)]
    if most:
        kinds.append(([k for k, own in enumerate(edges) if own == most], slice(-most, None), 1))
    found = []
    for whole, own, count in kinds:
        A = np.array([scale * jacobians[k][own] for k in whole])
        b = np.array([scale * residuals[k][own] for k in whole])
        split = count if b.shape[1] % count == 0 else 1
        early = sum(k < len(residuals) // 2 for k in whole)
        found.append(_one_kind(A, b, split, early, repeats=repeats))
    excess, first, *halves = (sum(every) for every in zip(*found, strict=True))
    return Likeness(excess=excess, halves=_disagreement(first, halves[:2], halves[2:], covariance))


def _one_kind(
    A: FloatArray, b: FloatArray, nodes: int, early: int, *, repeats: bool
) -> tuple[FloatArray, ...]:
    """Return excess, first half's score, and both halves' information and excess, of some rows.

    The first `early` blocks are the first half.
    """
    count, size, p = A.shape
    A, b = A.reshape(count * nodes, size // nodes, p), b.reshape(count * nodes, -1)
    fading = _autocovariance(b)
    middle = early * nodes
    halves = A[:middle], A[middle:]
    excess = _excess(A, fading)
    if repeats:
        values, vectors = np.linalg.eigh(_excess(A, _lagged(b)) - excess)
        excess = excess + (vectors * np.maximum(values, 0.0)) @ vectors.T
    return (
        excess,
        np.einsum("nci,nc->i", A[:middle], b[:middle]),
        *(np.einsum("nci,ncj->ij", one, one) for one in halves),
        *(_excess(one, fading) for one in halves),
    )


def besides_torques(
    residuals: Sequence[FloatArray],
    torques: Sequence[int],
    nodes: int,
    edges: Sequence[int] = (),
) -> list[FloatArray]:
    """Return the residuals that must be white: all but torques, of blocks that lack no channel.

    This is on a base that is held. On a free one all must be white: torques set it in motion too,
    so that errors of the base and of the inertial unit are in them as well.

    Parameters
    ----------
    torques : per block, number of leading rows of each node that are torques
    nodes : number of nodes per block
    edges : per block, number of its last rows, those of its edge, which depend on torques too
    """
    edges = edges or [0] * len(residuals)
    inner = [rows[: len(rows) - edge] for rows, edge in zip(residuals, edges, strict=True)]
    size = max(map(len, inner), default=0)
    whole = [k for k, rows in enumerate(inner) if len(rows) == size]
    first = min((torques[k] for k in whole), default=0)
    if size % nodes:
        return list(residuals)
    return [inner[k].reshape(nodes, -1)[:, first:].ravel() for k in whole]


def widened(covariance: FloatArray, excess: FloatArray) -> FloatArray:
    """Return the covariance (p, p) of an estimate whose score has an excess (p, p) of covariance.

    It is not smaller than the given one in any direction. What is estimated from residuals follows
    Student's distribution: sigma is widened until 3 sigma are as probable as those of a Gaussian.
    """
    F = np.linalg.cholesky(covariance)
    grown = F @ _grown(F.T @ excess @ F) @ F.T
    return np.asarray(covariance + 0.5 * (grown + grown.T), np.float64)


def unexplained(rows: Iterable[Rows], blocks: Sequence[Block], nodes: int) -> float:
    """Return the rms of the residual torques over that of the torques about their mean.

    Forces and moments of a wrench sensor are judged apart from the joints' torques, which may be
    far larger, where their residuals exceed the noise. The largest ratio counts.

    Parameters
    ----------
    rows : rows of each block at the estimate, with the root of their noise covariance
    nodes : number of nodes per block
    """
    found = [
        _torques(own, block, nodes)
        for own, block in zip(rows, blocks, strict=True)
        if own.root is not None and own.torques
    ]
    if not found:
        return np.inf
    left, sigma, torques = np.stack(found, axis=1)
    counts = np.maximum(np.isfinite(torques).sum(axis=(0, 1)), 1)
    about = torques - np.nansum(torques, axis=(0, 1)) / counts
    square, noise, power = (np.nansum(part**2, axis=(0, 1)) for part in (left, sigma, about))
    n, t = blocks[0].q_rad.shape[1], len(power)
    axes = (slice(k, k + 3) for k in range(n, t, 3))
    loud = (own for own in axes if square[own].sum() > LOUD * noise[own].sum())
    sums = [(square[own].sum(), power[own].sum()) for own in (slice(n), *loud)]
    return max(float(np.sqrt(rest / whole)) if whole else np.inf for rest, whole in sums)


def _torques(rows: Rows, block: Block, nodes: int) -> FloatArray:
    """Return residuals, sigmas and readings (3, m, t) of a block's torques, NaN: missing."""
    found = np.full((3, *block.tau_nm.shape), np.nan)
    at, has = rows.at_nodes, block.has_joint
    root = np.asarray(at.root)
    sigma = np.sqrt(np.sum(root**2, axis=1))
    with np.errstate(invalid="ignore", over="ignore"):  # of an estimate that ran away
        left = root @ at.b
    left[~np.isfinite(left)] = np.inf
    for own, values in enumerate((left, sigma)):
        found[own, :, has] = values.reshape(nodes, -1)[:, : rows.torques].T
    found[2, :, has] = block.tau_nm[:, has].T
    return found


def in_words(white: FloatArray, covariance: FloatArray, names: Sequence[str]) -> str:
    """Return by how much sigma has grown; empty: it has not.

    Parameters
    ----------
    white, covariance : (p, p) for white residuals, and as `widened`; `names` of the first states
    """
    count = len(names)
    grown = np.sqrt(np.diag(covariance)[:count] / np.diag(white)[:count])
    if not count or np.max(grown) <= 1.0:
        return ""
    k = int(np.argmax(grown))
    return (
        "residuals are alike from window to window and count as fewer: sigma is wider, of "
        f"{state_in_words(names[k])} {grown[k]:.2g} times; declare what the model lacks, such as "
        "friction, or leave it"
    )


def lasting(residuals: Sequence[FloatArray]) -> tuple[float, float]:
    """Return the correlation of residuals half a recording apart, and the limit of its size.

    Noise that fades has none. A constant, and what a repeated motion repeats, have a positive one,
    a swing as slow as the recording a negative one. The limit counts how few samples are
    independent where they are alike.
    Source: Bartlett, J. R. Statist. Soc. Suppl. 8 (1946) 27.

    Parameters
    ----------
    residuals : whitened, per block, oldest first; blocks with fewer rows than most are left out
    """
    size = max(map(len, residuals), default=0)
    b = np.array([rows for rows in residuals if len(rows) == size])
    half = len(b) // 2
    if half < 2 or size == 0:
        return 0.0, 1.0
    found = float(np.mean(np.sum(b[half:] * b[: len(b) - half], axis=1)))
    power, own = float(np.mean(np.sum(b**2, axis=1))), b - b.mean(axis=0)
    spread = float(np.mean(np.sum(own**2, axis=1)))  # power without a constant
    if spread == 0.0:
        return 0.0, 1.0
    across, along = own.T @ own / len(b), own @ own.T / spread
    lags = range(1, max(2, int(LONGEST * len(b))))
    fading = 1.0 + 2.0 * sum(float(np.mean(np.diagonal(along, lag))) ** 2 for lag in lags)
    chance = spread**2 / len(b)  # of the squares of white residuals' covariance
    rows = spread**2 / max(float(np.sum(across**2)) - chance, spread**2 / size)
    limit = LASTING_SIGMAS * np.sqrt(fading / (rows * (len(b) - half))) * spread / power
    return found / power, min(MOST_LASTING, max(LASTING, float(limit)))


def _lagged(b: FloatArray) -> FloatArray:
    """Return the autocovariance (N, C) of residuals (N, C), about zero."""
    power = np.abs(rfft(b, 2 * len(b), axis=0)) ** 2
    return np.asarray(irfft(power, 2 * len(b), axis=0)[: len(b)] / len(b), np.float64)


def _autocovariance(b: FloatArray) -> FloatArray:
    """Return the tapered autocovariance (J, C) of residuals (N, C), kinds that agree sharing it."""
    count = len(b)
    longest = max(2, int(LONGEST * count))
    x = np.arange(longest) / longest
    taper = np.where(x <= 0.5, 1.0 - 6.0 * x**2 + 6.0 * x**3, 2.0 * (1.0 - x) ** 3)
    lagged = _lagged(b)[:longest] * taper[:, None]
    size = np.maximum(lagged[0], 1e-300)
    fading = lagged / size
    lasts = np.maximum(2.0 * fading.sum(axis=0) - 1.0, 1e-3)  # long-run variance over the variance
    agree = np.abs(np.log(lasts / np.median(lasts))) < 2.0 * np.sqrt(2.0 / DOF)
    fading[:, agree] = fading[:, agree].mean(axis=1, keepdims=True)
    return np.asarray(size * fading, np.float64)


def _excess(A: FloatArray, lagged: FloatArray) -> FloatArray:
    """Return the long-run covariance of the score of rows (N, C, p) minus their information."""
    count, kinds, p = A.shape
    longest = min(len(lagged), count)
    total = np.zeros((p, p))
    for c in range(kinds if count else 0):  # a half may have no block with every channel
        column = np.zeros(2 * count)
        column[:longest] = lagged[:longest, c]
        column[1:] += column[:0:-1]
        rows = A[:, c]
        spectrum = rfft(column).real[:, None] * rfft(rows, 2 * count, axis=0)
        total += rows.T @ (irfft(spectrum, 2 * count, axis=0)[:count] - rows)
    return 0.5 * (total + total.T)


def _grown(excess: FloatArray) -> FloatArray:
    """Return by how much a unit covariance grows: the positive part, in Student's sigmas."""
    values, vectors = np.linalg.eigh(0.5 * (excess + excess.T))
    more = np.maximum(values, 0.0)
    dof = DOF * ((1.0 + more) / np.maximum(more, 1e-6)) ** 2
    grown = np.where(more > 0.0, (1.0 + more) * student(dof) - 1.0, 0.0)
    return np.asarray((vectors * grown) @ vectors.T, np.float64)


def _disagreement(
    score: FloatArray,
    information: Sequence[FloatArray],
    excess: Sequence[FloatArray],
    covariance: FloatArray,
) -> tuple[float, float]:
    """Return the squared whitened distance between two halves of the data, and its limit.

    At the estimate of both halves and the prior, the score of the first half is that of its own
    noise minus its share of everybody's noise.

    Parameters
    ----------
    score : (p,) of the first half
    information, excess : (p, p) of each half
    covariance : (p, p) of the estimate if the residuals were white
    """
    F, unit = np.linalg.cholesky(covariance), np.eye(len(score))
    shares = [F.T @ one @ F for one in information]
    noise = [own + _grown(F.T @ more @ F) for own, more in zip(shares, excess, strict=True)]
    rest, own = unit - shares[0], shares[0]
    spread = rest @ noise[0] @ rest.T + own @ (unit - shares[0] - shares[1] + noise[1]) @ own.T
    values, vectors = np.linalg.eigh(0.5 * (spread + spread.T))
    known = values > KNOWN
    squares = (vectors[:, known].T @ (F.T @ score)) ** 2 / values[known]
    dof = int(known.sum())
    return float(squares.sum()), float(chdtri(dof, CONTRADICTION)) if dof else float("inf")
