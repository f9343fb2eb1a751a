"""Judge an estimate by held-out windows: it predicts windows that it was not estimated from."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import chdtri

from fsw.errors import ConfigError
from fsw.estimators.block_view import fitting
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray
from offline.residuals import FALSE_ALARM, INDEPENDENT, channel_residuals

NOISE_RATIO = 1.5  # accepted ratio of found noise to declared noise (from data sheets)
DATA_SHARE = 0.5  # ratio of variance to prior variance; above it the prior says more than the data
MEAN_SIGMAS = 4.0


def split(blocks: Sequence[Block], share: float) -> tuple[Sequence[Block], Sequence[Block]]:
    """Return the windows to estimate from and the held-out windows, which are evenly spread.

    Raises
    ------
    ConfigError when the share is not in (0, 0.9], or one of the two lists would be empty.
    """
    if not 0.0 < share <= 0.9:
        raise ConfigError(f"--holdout: {share:g} must be greater than 0 and at most 0.9")
    count = np.floor(share * np.arange(len(blocks) + 1) + 1e-9)
    held = np.diff(count) > 0
    if held.all() or not held.any():
        raise ConfigError(f"--holdout: {share:g} of {len(blocks)} windows leaves one part empty")
    return fitting(blocks, ~held), fitting(blocks, held)


def judge(
    blocks: Sequence[Block],
    held: Sequence[Block],
    problem: Problem,
    x: FloatArray,
    covariance: FloatArray,
) -> dict[str, Any]:
    """Return plain values that state how well the held-out windows are predicted, by channel.

    A channel passes if the rms of residual / sigma is below its bound and the mean agrees with
    zero. With 1.5 times the declared noise, a correct model exceeds the bound of the rms once in
    ten thousand. Both bounds count the state's uncertainty as one error common to all nodes.

    Parameters
    ----------
    blocks : all windows in order, including the held-out ones
    x, covariance : the whole state (p,), (p, p), estimated without `held`

    Raises
    ------
    numpy.linalg.LinAlgError if the base has no inertia at this state.
    """
    out = {block.index for block in held}
    nodes = np.concatenate([np.full(len(b.t_ns), b.index in out) for b in blocks])
    r = channel_residuals(blocks, x, problem, covariance)
    exact = channel_residuals(blocks, x, problem)
    shared = 1.0 - (exact.sigma / r.sigma) ** 2  # share of the variance that is the state's
    channels = {}
    for k, (name, unit) in enumerate(zip(r.names, r.units, strict=True)):
        used = nodes & np.isfinite(r.value[:, k])
        if used.any():
            value, ratio = r.value[used, k], r.normalised[used, k]
            channels[name] = _verdict(value, ratio, float(shared[used, k].mean()), unit)
    known = np.diag(covariance) / np.diag(problem.prior_covariance)
    return {
        "windows": len(held),
        "passed": bool(channels) and all(channel["passed"] for channel in channels.values()),
        "channels": channels,
        "prior_only": [problem.names[k] for k in problem.published if known[k] > DATA_SHARE],
    }


def _verdict(value: FloatArray, ratio: FloatArray, shared: float, unit: str) -> dict[str, Any]:
    count = max(1.0, INDEPENDENT * len(ratio))
    own, common = chdtri(count, FALSE_ALARM) / count, chdtri(1.0, FALSE_ALARM)
    most = NOISE_RATIO * float(np.sqrt((1.0 - shared) * own + shared * common))
    off = MEAN_SIGMAS * float(np.sqrt(1.0 / count + shared))
    rms, mean = float(np.sqrt(np.mean(ratio**2))), float(np.mean(ratio))
    return {
        "unit": unit,
        "nodes": len(ratio),
        "rms": float(np.sqrt(np.mean(value**2))),
        "rms_over_sigma": rms,
        "bound": most,
        "mean_over_sigma": mean,
        "mean_bound": off,
        "passed": rms <= most and abs(mean) <= off,
    }


def unpredicted(holdout: Mapping[str, Any]) -> str:
    """Return which channels of `judge` are not predicted; empty: all are."""
    failed = [name for name, channel in holdout["channels"].items() if not channel["passed"]]
    return f"held-out windows are not predicted: {', '.join(failed)}" if failed else ""


def to_text(holdout: Mapping[str, Any]) -> list[str]:
    """Return the values of `judge` as lines of text, the verdict first."""
    verdict = "PASSED" if holdout["passed"] else "FAILED"
    lines = [f"held out: {verdict}, {holdout['windows']} windows predicted"]
    if not holdout["passed"] and not unpredicted(holdout):
        lines[0] += "; every channel is, but the data contradict the configuration: see above"
    for name, c in holdout["channels"].items():
        lines.append(
            f"{name}: rms {c['rms']:.3g} {c['unit']}, {c['rms_over_sigma']:.2f} sigma "
            f"(bound {c['bound']:.2f}), mean {c['mean_over_sigma']:+.2f} sigma "
            f"(bound {c['mean_bound']:.2f}){'' if c['passed'] else ' FAILED'}"
        )
    if holdout["prior_only"]:
        lines.append(f"known by the prior alone: {', '.join(holdout['prior_only'])}")
    return lines
