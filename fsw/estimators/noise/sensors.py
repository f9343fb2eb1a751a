"""Noise of sensors that is not white: found from the samples, counted in the covariance.

A window's polynomial holds the motion; its residuals are noise. Their mean products, some samples
apart, show whether neighbouring samples are correlated. The noise of a channel is modelled as a
white part and one that fades exponentially, an autoregression of first order (Box, Jenkins, Time
Series Analysis, 1976, sec. 3.2). The fading found from one sensor alone is uncertain, and too slow
a fading does more harm than too fast a one. So torque sensors share one fading, unless their own
samples contradict it, and keep their sizes. The covariance at the nodes includes that with the
nodes of neighbouring windows, so that a slowly changing quantity gets the information that all
windows together hold (the long-run variance). White noise keeps exactly the declared covariance.

Channels are the torques (of joints, then axes of wrench sensors), then gyro and accelerometer,
whose three axes count as alike.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.estimators.conditioning.polynomial import EXTRA_DEGREE
from fsw.estimators.noise.found import (
    LAGS,
    Found,
    found_noise,
    shapes_of,
    shared_fading,
    size_at_nodes,
)
from fsw.estimators.recursive.snapshot import Values, kept, put
from fsw.messages import Block, FloatArray

MOVED = 0.1  # relative change of a variance at the nodes that is worth a pass
INERTIAL = (("gyro", "rad/s"), ("accelerometer", "m/s^2"))
SHARED = ("white_ratio", "correlation_s", "samples", "effective_samples")
_STATE = ("_sums", "_windows", "_excess")


@dataclass(frozen=True, slots=True)
class ChannelNoise:
    """Declared noise of one channel, and the noise found, in the channel's unit.

    Parameters
    ----------
    declared : 1 sigma of a sample, from the configuration
    sigma : 1 sigma of a sample, found
    white_ratio : share of the variance that is white
    correlation_s : time in which the other part fades by e; 0: the noise is white
    samples : number of samples that were used
    effective_samples : number of white samples of this sigma that determine a constant as well
    """

    declared: float
    sigma: float
    white_ratio: float
    correlation_s: float
    samples: int
    effective_samples: float

    @property
    def is_white(self) -> bool:
        """Return whether no correlation was found; then the declared noise is used."""
        return self.correlation_s == 0.0


class SensorNoise:
    """The noise of n torques, gyro and accelerometer, learnt from the blocks so far.

    Parameters
    ----------
    declared : (n + 2,) 1 sigma of a sample
    samples : (n + 2,) number in a window
    window_s : length of a window
    nodes : number in a block
    model_nm2 : (n, m, m) covariance that blocks include for torques outside the model; None: zero

    Attributes
    ----------
    channels : the noise of each channel
    """

    def __init__(
        self,
        declared: FloatArray,
        samples: NDArray[np.int64],
        window_s: float,
        nodes: int,
        model_nm2: FloatArray | None = None,
    ) -> None:
        self._declared, self._samples = declared, samples
        self._window_s, self._nodes = window_s, nodes
        self._counted = np.zeros((len(declared), 2 * nodes, 2 * nodes))
        if model_nm2 is not None:
            self._counted[: len(model_nm2), :nodes, :nodes] = model_nm2
        self._sums = np.zeros((len(LAGS), len(declared)))
        self._windows = np.zeros(len(declared), np.int64)  # of the inertial unit: times axes
        # (n + 2, 2 m, 2 m) added to the declared covariance; see `Shapes`
        self._excess: FloatArray | None = None
        for count in {k for k in samples.tolist() if k > nodes + EXTRA_DEGREE}:
            shapes_of(count, nodes)  # cached: takes a tenth of a second, too long for the loop
        self.channels = self._judged(self._found())

    def note(self, block: Block) -> None:
        """Add a block's mean products to the sums."""
        n = len(block.has_joint)
        usable = np.array([*block.has_joint, block.has_gyro, block.has_accelerometer])
        axes = np.repeat([1, 3], [n, 2])
        for own, products in (
            (slice(n), block.tau_products_nm2),
            (slice(n, n + 2), block.imu_products),
        ):
            if len(products) == len(self._sums):
                counted = axes[own] * ((products[0] > 0.0) & usable[own])
                self._sums[:, own] += np.where(counted, counted * products, 0.0)
                self._windows[own] += counted

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
        least = self._declared**2 * self._nodes / self._samples
        before, after = (
            np.array([size_at_nodes(C, self._nodes) for C in own]) for own in (held, new)
        )
        change = np.abs(after - before) / (before + self._nodes * least)
        if change.max() <= MOVED:
            return False
        self._excess = new
        return True

    def applied(self, block: Block) -> Block:
        """Return the block with the noise that was found added to its covariances."""
        if self._excess is None:
            return block
        n, m = len(block.has_joint), self._nodes
        usable, torque = block.has_joint[:, None, None], self._excess[:n, :m, :m]
        per_s = np.repeat([1.0, 2.0 / self._window_s], m)
        gyro, acc = self._excess[n] * np.outer(per_s, per_s), self._excess[n + 1, :m, :m]
        return replace(
            block,
            cov_tau=block.cov_tau + np.where(usable, torque, 0.0),
            cov_gyro=block.cov_gyro + gyro if block.has_gyro else block.cov_gyro,
            cov_acc=block.cov_acc + acc if block.has_accelerometer else block.cov_acc,
        )

    def report(self, units: Mapping[str, str], joints: int) -> dict[str, list[dict[str, Any]]]:
        """Return plain values of every channel's noise: of torques, wrench and inertial sensors.

        `units`: of torques by name; the first `joints` of them are of joints, the others of axes.
        """
        found = [
            {"channel": name, "unit": unit} | asdict(noise)
            for name, unit, noise in self._named(units)
        ]
        torque = []
        for own in found[:joints]:
            unit = "n" if own["unit"] == "N" else "nm"  # of a prismatic joint
            sizes = {f"declared_{unit}": own["declared"], f"sigma_{unit}": own["sigma"]}
            torque.append({"joint": own["channel"], **sizes, **{key: own[key] for key in SHARED}})
        wrench, inertial = found[joints : len(units)], found[len(units) :]
        return {"torque_noise": torque, "wrench_noise": wrench, "inertial_noise": inertial}

    def words(self, units: Mapping[str, str]) -> str:
        """Return a text with sigma and correlation time of channels whose noise is not white."""
        return ", ".join(
            f"{name} {noise.sigma:.3g} {unit}, {1e3 * noise.correlation_s:.3g} ms"
            for name, unit, noise in self._named(units)
            if not noise.is_white
        )

    def _named(self, units: Mapping[str, str]) -> list[tuple[str, str, ChannelNoise]]:
        channels = [*units.items(), *INERTIAL]
        pairs = zip(channels, self.channels, strict=True)
        return [(name, unit, noise) for (name, unit), noise in pairs]

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain values."""
        return kept(self, _STATE)

    def restore(self, values: Values) -> None:
        """Continue from a snapshot."""
        put(self, _STATE, values)
        self.channels = self._judged(self._found())

    def _found(self) -> list[Found | None]:
        """Return the noise found of each sensor; None: it is white, or not known yet."""
        found: list[Found | None] = []
        for j, windows in enumerate(self._windows.tolist()):
            samples = int(self._samples[j])
            known = windows > 0
            found.append(
                found_noise(self._sums[:, j] / windows, windows, samples, self._nodes)
                if known
                else None
            )
        coloured = [j for j, own in enumerate(found[:-2]) if own is not None]
        for samples in sorted({int(self._samples[j]) for j in coloured}):
            k = [j for j in coloured if self._samples[j] == samples]
            counts = self._windows[k]
            shared = shared_fading(self._sums[:, k] / counts, counts, samples, self._nodes)
            for j, own in zip(k, shared, strict=True):
                found[j] = own or found[j]
        return found

    def _judged(self, found: Sequence[Found | None]) -> tuple[ChannelNoise, ...]:
        return tuple(self._channel(j, own) for j, own in enumerate(found))

    def _channel(self, j: int, found: Found | None) -> ChannelNoise:
        declared, windows = float(self._declared[j]), int(self._windows[j])
        samples = int(self._samples[j])
        count = samples * windows
        if not windows:
            return ChannelNoise(declared, declared, 1.0, 0.0, 0, 0.0)
        shapes = shapes_of(samples, self._nodes)
        if found is None:
            sigma = float(np.sqrt(self._sums[0, j] / windows / shapes.white[0]))
            return ChannelNoise(declared, sigma, 1.0, 0.0, count, float(count))
        white, fading, k = found
        a, total = float(shapes.fading[k]), white + fading
        return ChannelNoise(
            declared=declared,
            sigma=float(np.sqrt(total)),
            white_ratio=white / total,
            correlation_s=-self._window_s / samples / float(np.log(a)),
            samples=count,
            effective_samples=count * total / (white + fading * (1.0 + a) / (1.0 - a)),
        )

    def _excess_of(self, j: int, found: Found | None) -> FloatArray:
        """Return the excess of the found over the declared covariance at the nodes (2 m, 2 m).

        Noise smaller than declared keeps the declared size, because a sensor at rest may show less.
        The samples also hold the torque that the model leaves out, and this must not count twice:
        the larger of the found excess and the configured covariance counts.
        """
        if found is None:
            return np.zeros_like(self._counted[j])
        white, fading, k = found
        at_nodes = shapes_of(int(self._samples[j]), self._nodes).at_nodes
        declared = float(self._declared[j]) ** 2
        size = max(1.0, declared / (white + fading))
        excess = (size * white - declared) * at_nodes[0] + size * fading * at_nodes[k + 1]
        counted = self._counted[j]
        if size_at_nodes(excess, self._nodes) <= size_at_nodes(counted, self._nodes):
            return np.zeros_like(counted)
        return np.asarray(excess - counted)
