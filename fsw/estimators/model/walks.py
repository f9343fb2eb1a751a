"""The walk of integrated angles as states: steps between knots on the scale of its variance.

White noise of a speed makes its integral a Wiener process. On the scale of its own variance v it is
one of unit density, wherever samples or whole windows were missing; so knots are placed by v. The
steps between knots are independent, each with the variance between its knots; between two knots the
walk is taken as linear, and what is left is a Brownian bridge (Karatzas, Shreve, Brownian Motion
and Stochastic Calculus, 1991, sec. 5.6.B), which counts as noise of every block. All blocks of a
step share one bridge, so that this noise is declared larger by half their number: the mean of a
bridge over its step has half of the mean variance of its points, T/12 and T/6.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.messages import Block, FloatArray

STEPS = 32  # over the windows that the store holds
MOST_STEPS = 96  # of a batch
LEAST_RAD2 = 1e-18


@dataclass(frozen=True, slots=True, eq=False)
class Walks:
    """Knots of the walks of k joints."""

    joints: NDArray[np.intp]  # (k,) in the model's order
    knots_rad2: FloatArray  # (k, K + 1) ascending
    blocks: float  # in a step

    @property
    def steps_rad2(self) -> FloatArray:
        """Return the variance (k, K) of every step."""
        return np.asarray(np.diff(self.knots_rad2, axis=1), np.float64)

    def shares(self, walk_rad2: FloatArray) -> FloatArray:
        """Return the share (B, k, K) of every step that is done where the walk has (B, n)."""
        beyond = walk_rad2[:, self.joints, None] - self.knots_rad2[:, :-1]
        return np.asarray(np.clip(beyond / self.steps_rad2, 0.0, 1.0))

    def beside(self, walk_rad2: FloatArray) -> FloatArray:
        """Return the variance (B, k) of what the steps leave: bridges, and what is beyond them."""
        s = self.shares(walk_rad2)
        bridges = np.sum(s * (1.0 - s) * self.steps_rad2, axis=2) * max(1.0, 0.5 * self.blocks)
        beyond = np.maximum(walk_rad2[:, self.joints] - self.knots_rad2[:, -1], 0.0)
        return np.asarray(bridges + beyond, np.float64)

    def moved(self, steps_rad: FloatArray, walk_rad2: FloatArray) -> FloatArray:
        """Return by how much angles have walked (B, n) by their steps (k K,), there (B, n)."""
        by = np.zeros_like(walk_rad2)
        by[:, self.joints] = np.einsum(
            "bkj,kj->bk", self.shares(walk_rad2), steps_rad.reshape(self.steps_rad2.shape)
        )
        return by


def walks_of(config: Config, order: Sequence[int], blocks: Sequence[Block] = ()) -> Walks | None:
    """Return the knots for blocks, or for as many windows as the store holds; None: no walk.

    Those of blocks are as dense in time as the others, up to MOST_STEPS of them.
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
    spread = LEAST_RAD2 * np.arange(knots.shape[1])  # where a joint's walk stands still
    return Walks(own, knots + spread, count / (knots.shape[1] - 1))
