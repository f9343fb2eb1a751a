"""Noise of the torque sensors that is not white: found from the samples, counted in the covariance.

A window's polynomial holds the motion; what it leaves is noise, and the mean products of what is
left, some samples apart, show whether neighbouring samples are alike. The noise of a channel is
taken as a white part and one that fades exponentially, an autoregression of first order (Box,
Jenkins, Time Series Analysis, 1976, sec. 3.2). Its covariance at the nodes includes that with the
nodes of neighbouring windows, so that a quantity which changes slowly gets the information that all
windows together hold (the long-run variance). White noise is left as declared, to the bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from fsw.estimators.fading_noise import covariance_at_nodes, instants
from fsw.estimators.polynomial import EXTRA_DEGREE
from fsw.estimators.recursive.snapshot import Values, kept, put
from fsw.messages import Block, FloatArray

LAGS = (0, 1, 2, 3, 5, 8, 12, 18, 27, 40)  # samples between the factors of a mean product
TIMES = 16  # correlation times that are compared, from one sample to a quarter of the window
SIGNIFICANT = 50.0  # fall of the misfit, times samples, that white noise makes once in 1e10 sets
LEAST_INFLATION = 1.1  # of the variance; less is not worth a change
MOVED = 0.1  # relative change of a variance at the nodes that is worth a pass
_STATE = ("_sums", "_windows", "_excess")

Found = tuple[float, float, int]  # variance of the white and of the fading part, number of its time


@dataclass(frozen=True, slots=True)
class ChannelNoise:
    """Noise found on one torque sensor, beside the declared one.

    Parameters
    ----------
    declared_nm : 1 sigma of a sample, from the configuration
    sigma_nm : 1 sigma of a sample, found
    white_ratio : share of the variance that is white
    correlation_s : time in which the other part fades by e; 0: the noise is white
    samples : number of samples that say so
    effective_samples : white samples of that sigma from which a constant would be known as well
    """

    declared_nm: float
    sigma_nm: float
    white_ratio: float
    correlation_s: float
    samples: int
    effective_samples: float

    @property
    def is_white(self) -> bool:
        """Return whether the noise is taken as declared."""
        return self.correlation_s == 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Shapes:
    """What noise of unit variance does in a window of some samples; T correlation times.

    Attributes
    ----------
    fading : (T,) correlation from sample to sample
    white, faded : (L,) and (T, L) expected mean products of what the polynomial leaves
    at_nodes : (T + 1, m, m) covariance at the nodes; white noise first
    """

    fading: FloatArray
    white: FloatArray
    faded: FloatArray
    at_nodes: FloatArray


@lru_cache(maxsize=8)
def _shapes(samples: int, nodes: int) -> _Shapes:
    """Return the shapes for windows of so many samples and blocks of so many nodes."""
    removed = np.linalg.qr(legendre.legvander(instants(samples), nodes - 1 + EXTRA_DEGREE))[0]
    place = np.arange(samples)
    fading = np.exp(-1.0 / np.geomspace(1.0, samples / 4.0, TIMES))
    products, at_nodes = [], []
    for a in (0.0, *fading.tolist()):
        C = toeplitz(a**place)
        left = C - removed @ (removed.T @ C)
        left -= (left @ removed) @ removed.T
        products.append([np.trace(left, lag) / samples for lag in LAGS])
        at_nodes.append(covariance_at_nodes(samples, nodes, a))
    white, faded = np.array(products[0]), np.array(products[1:])
    return _Shapes(fading, white, faded, np.array(at_nodes))


def mean_products(residuals: FloatArray) -> FloatArray:
    """Return the mean products (L, n) of residuals (k, n), LAGS samples apart."""
    k = len(residuals)
    pairs = [(residuals[lag:], residuals[: max(0, k - lag)]) for lag in LAGS]
    return np.array([np.einsum("ij,ij->j", late, early) for late, early in pairs]) / k


def gapped_products(residuals: FloatArray, place: NDArray[np.int64]) -> FloatArray:
    """Return what `mean_products` would have of samples of which some are lost.

    Parameters
    ----------
    residuals : (k, n)
    place : (k,) numbers of the samples' periods, ascending
    """
    k = int(place[-1] - place[0]) + 1
    whole, known = np.zeros((k, residuals.shape[1])), np.zeros(k, np.bool_)
    whole[place - place[0]], known[place - place[0]] = residuals, True
    share = np.zeros(len(LAGS))
    for row, lag in enumerate(LAGS):
        pairs = np.count_nonzero(known[lag:] & known[: max(0, k - lag)])
        share[row] = (k - lag) / pairs if pairs else 0.0
    return np.asarray(mean_products(whole) * share[:, None])


def found_noise(products: FloatArray, windows: int, samples: int, nodes: int) -> Found | None:
    """Return the variances of the white and the fading part and the number of its time.

    None: nothing speaks against white noise.

    Parameters
    ----------
    products : (L,) mean products of residuals, over so many windows of so many samples
    """
    shapes = _shapes(samples, nodes)
    a, F, y = shapes.white, shapes.faded, products / products[0]
    aa, ff, af, ay, fy = a @ a, np.sum(F * F, axis=1), F @ a, a @ y, F @ y
    fading = np.maximum(0.0, (aa * fy - af * ay) / (aa * ff - af**2))
    white = (ay - fading * af) / aa
    fading = np.where(white < 0.0, np.maximum(0.0, fy / ff), fading)
    white = np.maximum(0.0, white)
    gain = 2.0 * (white * ay + fading * fy)
    gain -= white**2 * aa + 2.0 * white * fading * af + fading**2 * ff
    k = int(np.argmax(gain))
    if fading[k] == 0.0 or (gain[k] - ay**2 / aa) * windows * samples < SIGNIFICANT:
        return None
    at_white, at_faded = (float(np.trace(C)) for C in shapes.at_nodes[[0, k + 1]])
    total = white[k] + fading[k]
    if white[k] * at_white + fading[k] * at_faded < LEAST_INFLATION * total * at_white:
        return None
    return float(products[0] * white[k]), float(products[0] * fading[k]), k


class TorqueNoise:
    """The noise of every torque sensor, as far as the blocks so far show.

    Parameters
    ----------
    declared_nm : (n,) 1 sigma of a sample
    samples : (n,) of a window
    window_s : length of a window
    nodes : of a block
    model_nm2 : (n, m, m) what the blocks count already of what the model leaves out; None: nothing

    Attributes
    ----------
    channels : the noise of each sensor
    """

    def __init__(
        self,
        declared_nm: FloatArray,
        samples: NDArray[np.int64],
        window_s: float,
        nodes: int,
        model_nm2: FloatArray | None = None,
    ) -> None:
        self._declared_nm, self._samples = declared_nm, samples
        self._window_s, self._nodes = window_s, nodes
        none = np.zeros((len(declared_nm), nodes, nodes))
        self._model_nm2 = none if model_nm2 is None else model_nm2
        self._sums = np.zeros((len(LAGS), len(declared_nm)))
        self._windows = np.zeros(len(declared_nm), np.int64)
        self._excess: FloatArray | None = None  # (n, m, m) added to the declared covariance
        for count in set(samples.tolist()):
            _shapes(count, nodes)  # takes a tenth of a second: not while the loop runs
        self.channels = self._judged(self._found())

    def note(self, block: Block) -> None:
        """Add what a block shows of the noise."""
        products = block.tau_products_nm2
        if products.shape == self._sums.shape:
            counted = (products[0] > 0.0) & block.has_joint
            self._sums += np.where(counted, products, 0.0)
            self._windows += counted

    def learn(self) -> bool:
        """Judge the noise by all blocks; return whether variances at the nodes change markedly."""
        found = self._found()
        self.channels = self._judged(found)
        new = np.stack([self._excess_of(j, own) for j, own in enumerate(found)])
        held = self._excess
        if held is None:
            if not new.any():
                return False
            held = np.zeros_like(new)
        least = self._declared_nm**2 * self._nodes / self._samples
        change = np.abs(_variances(new) - _variances(held)) / (_variances(held) + least)
        if change.max() <= MOVED:
            return False
        self._excess = new
        return True

    def applied(self, block: Block) -> Block:
        """Return a block whose torques have the covariance that was found."""
        if self._excess is None:
            return block
        usable = block.has_joint[:, None, None]
        return replace(block, cov_tau=block.cov_tau + np.where(usable, self._excess, 0.0))

    def report(self, names: Sequence[str]) -> list[dict[str, Any]]:
        """Return plain values of every sensor, by the names of the joints."""
        return [
            {"joint": name} | asdict(noise)
            for name, noise in zip(names, self.channels, strict=True)
        ]

    def words(self, names: Sequence[str]) -> str:
        """Return which sensors are correlated in time, and how."""
        return ", ".join(
            f"{name} {noise.sigma_nm:.3g} N m, {1e3 * noise.correlation_s:.3g} ms"
            for name, noise in zip(names, self.channels, strict=True)
            if not noise.is_white
        )

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain values."""
        return kept(self, _STATE)

    def restore(self, values: Values) -> None:
        """Continue from a snapshot."""
        put(self, _STATE, values)
        self.channels = self._judged(self._found())

    def _found(self) -> list[Found | None]:
        """Return what is found of each sensor; None: its noise is white, or not known yet."""
        found: list[Found | None] = []
        for j, windows in enumerate(self._windows.tolist()):
            samples = int(self._samples[j])
            known = windows > 0
            found.append(
                found_noise(self._sums[:, j] / windows, windows, samples, self._nodes)
                if known
                else None
            )
        return found

    def _judged(self, found: Sequence[Found | None]) -> tuple[ChannelNoise, ...]:
        return tuple(self._channel(j, own) for j, own in enumerate(found))

    def _channel(self, j: int, found: Found | None) -> ChannelNoise:
        declared, windows = float(self._declared_nm[j]), int(self._windows[j])
        samples = int(self._samples[j])
        count, shapes = samples * windows, _shapes(samples, self._nodes)
        if found is None:
            variance = float(self._sums[0, j]) / windows / shapes.white[0] if windows else None
            sigma = declared if variance is None else float(np.sqrt(variance))
            return ChannelNoise(declared, sigma, 1.0, 0.0, count, float(count))
        white, fading, k = found
        a, total = float(shapes.fading[k]), white + fading
        return ChannelNoise(
            declared_nm=declared,
            sigma_nm=float(np.sqrt(total)),
            white_ratio=white / total,
            correlation_s=-self._window_s / samples / float(np.log(a)),
            samples=count,
            effective_samples=count * total / (white + fading * (1.0 + a) / (1.0 - a)),
        )

    def _excess_of(self, j: int, found: Found | None) -> FloatArray:
        """Return what the found noise adds to the declared covariance at the nodes (m, m).

        Noise smaller than declared keeps the declared size: a sensor at rest may show less of it.
        What the model leaves out is in the samples too and is not counted twice: the larger of what
        is found and what is declared of it holds.
        """
        if found is None:
            return np.zeros((self._nodes, self._nodes))
        white, fading, k = found
        at_nodes = _shapes(int(self._samples[j]), self._nodes).at_nodes
        declared = float(self._declared_nm[j]) ** 2
        size = max(1.0, declared / (white + fading))
        excess = (size * white - declared) * at_nodes[0] + size * fading * at_nodes[k + 1]
        counted = self._model_nm2[j]
        if np.trace(excess) <= np.trace(counted):
            return np.zeros_like(counted)
        return np.asarray(excess - counted)


def _variances(matrices: FloatArray) -> FloatArray:
    """Return the mean variances (n,) of covariances (n, m, m)."""
    return np.asarray(np.einsum("nii->n", matrices) / matrices.shape[-1])
