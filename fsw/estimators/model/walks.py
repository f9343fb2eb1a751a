"""Random walks of integrated angles as states: one state per step between two knots.

Where an encoder gives speed only, the angle is an integral, and white noise of the speed makes its
error a Wiener process. Knots are placed by the variance v of this process instead of time, so that
missing samples or windows make no difference. The steps between knots are independent, each with
the variance between its knots. Between two knots the walk is taken as linear. The remainder is a
Brownian bridge (Karatzas, Shreve, Brownian Motion and Stochastic Calculus, 1991, sec. 5.6.B), which
counts as noise of every block. All blocks of a step share one bridge, so its variance is multiplied
by half their number: a bridge's mean over its step has the variance T/12, half of the mean variance
T/6 of its points.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.messages import Block, FloatArray

STEPS = 32  # of a walk over the windows that the store holds
MOST_STEPS = 96  # of a walk over the blocks of a batch
LEAST_RAD2 = 1e-18


@dataclass(frozen=True, slots=True, eq=False)
class Walks:
    """Knots of the random walks of k joints."""

    joints: NDArray[np.intp]  # (k,) indices in the model's order
    knots_rad2: FloatArray  # (k, K + 1) ascending
    blocks: float  # mean number in a step

    @property
    def steps_rad2(self) -> FloatArray:
        """Return the variance (k, K) of every step [rad^2]."""
        return np.asarray(np.diff(self.knots_rad2, axis=1), np.float64)

    def shares(self, walk_rad2: FloatArray) -> FloatArray:
        """Return the completed share (B, k, K) of every step at walk variances (B, n)."""
        beyond = walk_rad2[:, self.joints, None] - self.knots_rad2[:, :-1]
        return np.asarray(np.clip(beyond / self.steps_rad2, 0.0, 1.0))

    def beside(self, walk_rad2: FloatArray) -> FloatArray:
        """Return the variance (B, k) outside the steps: bridges, and walk after the last knot."""
        s = self.shares(walk_rad2)
        bridges = np.sum(s * (1.0 - s) * self.steps_rad2, axis=2) * max(1.0, 0.5 * self.blocks)
        beyond = np.maximum(walk_rad2[:, self.joints] - self.knots_rad2[:, -1], 0.0)
        return np.asarray(bridges + beyond, np.float64)

    def moved(self, steps_rad: FloatArray, walk_rad2: FloatArray) -> FloatArray:
        """Return the walk of angles (B, n) [rad] by its steps (k K,), at walk variances (B, n)."""
        by = np.zeros_like(walk_rad2)
        by[:, self.joints] = np.einsum(
            "bkj,kj->bk", self.shares(walk_rad2), steps_rad.reshape(self.steps_rad2.shape)
        )
        return by


def walks_of(config: Config, order: Sequence[int], blocks: Sequence[Block] = ()) -> Walks | None:
    """Return the knots over blocks, or else over as many windows as the store holds.

    None: every encoder gives angles. Steps over blocks last as long, but are at most MOST_STEPS.
    """
    joints = [config.joints[k] for k in order]
    own = np.array([k for k, joint in enumerate(joints) if joint.speed_only], np.intp)
    if not own.size:
        return None
    stored = config.estimator.store_blocks
    if blocks:
        walk = np.array([block.walk_rad2[own] for block in blocks])
        steps = int(np.clip(-(-STEPS * len(blocks) // stored), 2, MOST_STEPS))
        knots, count = walk[np.linspace(0, len(walk) - 1, steps + 1).astype(int)].T, len(walk)
    else:
        rates_hz = {bus.name: bus.rate_hz for bus in config.buses}
        density = [(joints[k].speed_noise_rad_s or 0.0) ** 2 / rates_hz[joints[k].bus] for k in own]
        whole = np.array(density) * stored * config.estimator.window_s
        knots, count = np.linspace(0.0, whole, STEPS + 1).T, stored
    spread = LEAST_RAD2 * np.arange(knots.shape[1])  # keeps knots apart where a walk stands still
    return Walks(own, knots + spread, count / (knots.shape[1] - 1))
