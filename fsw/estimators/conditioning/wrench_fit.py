"""The wrench sensors' part of a block: their axes at the nodes of a window."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.estimators.conditioning.arm_motion import is_doubtful, tells_of_noise
from fsw.estimators.conditioning.polynomial import EXTRA_DEGREE
from fsw.estimators.conditioning.window_fit import NO_FIT, Fitted, Instants, Wanted
from fsw.estimators.noise.found import LAGS
from fsw.messages import FloatArray, Window
from fsw.messages.findings import Fault

Removed = list[tuple[str, Fault, int]]  # sensor, fault, number of samples left out


@dataclass(frozen=True, slots=True, eq=False)
class Wrenches:
    """Values of c axes as a block has them; see `Block`."""

    tau: FloatArray  # (m, c) [N or N m]
    cov_tau: FloatArray  # (c, m, m)
    products: FloatArray  # (L, c)
    has: NDArray[np.bool_]  # (c,)


class WrenchConditioner:
    """Fits the axes of every wrench sensor as those of a joint's torque."""

    def __init__(self, config: Config) -> None:
        self._nodes, self._min_fill = config.estimator.nodes, config.estimator.min_fill_ratio
        self._names = [sensor.name for sensor in config.wrench_sensors]
        self._sigmas = [np.array(sensor.noise) for sensor in config.wrench_sensors]
        window_s = config.estimator.window_s
        self._samples = [max(1, round(window_s * s.rate_hz)) for s in config.wrench_sensors]

    def wanted(self, window: Window, *, gated: bool) -> list[Wanted | None]:
        """Return the fit that each sensor needs; None: its samples are missing."""
        m, half_s = self._nodes, (window.stop_ns - window.start_ns) * 0.5e-9
        centre_ns = (window.start_ns + window.stop_ns) // 2
        found: list[Wanted | None] = []
        for channel, sigmas, samples in zip(
            window.of("wrench_sensors"), self._sigmas, self._samples, strict=True
        ):
            if channel.missing:
                found.append(None)
                continue
            high, count = m - 1 + EXTRA_DEGREE, len(channel.t_ns)
            enough = count > high + 1
            tells = gated and enough and tells_of_noise(count / samples)
            found.append(
                Wanted(
                    Instants(
                        (channel.t_ns - centre_ns).tobytes(), half_s, m, high if enough else m - 1
                    ),
                    channel.values,
                    sigmas if gated else np.full(len(sigmas), np.inf),
                    m - 1,
                    (0,),
                    min_fill=self._min_fill,
                    samples=samples if tells else 0,
                )
            )
        return found

    def made(
        self, wanted: Sequence[Wanted | None], fitted: Iterator[Fitted]
    ) -> tuple[Wrenches, Removed]:
        """Return the axes from their fits, the next ones of `fitted`, and the samples left out."""
        removed, parts = Removed(), [_nothing(self._nodes)]
        for name, sigmas, asked in zip(self._names, self._sigmas, wanted, strict=True):
            found = None if asked is None else next(fitted)
            alike = np.ones(len(sigmas))
            if asked is not None:  # a reading that is repeated through the window counts once
                is_held = (asked.values == asked.values[:1]).all(axis=0)
                alike[is_held] = len(asked.values)
            parts.append(self._sensor(name, sigmas * np.sqrt(alike), found, removed))
        return Wrenches(
            np.concatenate([part.tau for part in parts], axis=1),
            np.concatenate([part.cov_tau for part in parts]),
            np.concatenate([part.products for part in parts], axis=1),
            np.concatenate([part.has for part in parts]),
        ), removed

    def _sensor(
        self, name: str, sigmas: FloatArray, found: Fitted | None, removed: Removed
    ) -> Wrenches:
        m, c = self._nodes, len(sigmas)
        tau, cov_tau = np.zeros((m, c)), np.empty((c, m, m))
        products, has = np.zeros((len(LAGS), c)), np.zeros(c, np.bool_)
        for k, sigma in enumerate(sigmas.tolist()):
            fit = NO_FIT if found is None else found.channels[k]
            if found is not None and is_doubtful(fit.removed, found.samples):
                removed.append((name, Fault.TORQUE_INCONSISTENT, fit.removed))
                fit = NO_FIT
            removed.append((name, Fault.TORQUE_SPIKE, fit.removed))
            cov_tau[k] = fit.covariance((0,), sigma, m)
            if fit.fit is None:
                continue
            tau[:, k], has[k] = fit.values[:, 0], True
            if found is not None and not fit.removed:
                products[:, k] = found.products[:, k]
        return Wrenches(tau, cov_tau, products, has)


def _nothing(m: int) -> Wrenches:
    axes = np.zeros((m, 0)), np.zeros((0, m, m)), np.zeros((len(LAGS), 0))
    return Wrenches(*axes, np.zeros(0, np.bool_))
