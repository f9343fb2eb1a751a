"""The gravity-gradient field along a circular orbit, in base axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsw.config import OrbitConfig
from fsw.messages import Block, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CircularOrbit:
    """A circular orbit by its unit position and along-track vectors at the epoch, in inertial axes.

    `gradient_1_s2` is mu/R^3. Source: paper eq. (26), as a field acting on every mass element.
    """

    r_hat: FloatArray  # (3,)
    t_hat: FloatArray  # (3,)
    gradient_1_s2: float
    epoch_ns: int | None

    @staticmethod
    def from_config(config: OrbitConfig) -> CircularOrbit:
        """Build from a validated configuration."""
        position, velocity = np.array(config.position_m), np.array(config.velocity_m_s)
        radius = float(np.linalg.norm(position))
        r_hat = position / radius
        across = velocity - (velocity @ r_hat) * r_hat
        return CircularOrbit(
            r_hat=r_hat,
            t_hat=across / np.linalg.norm(across),
            gradient_1_s2=config.gravity_parameter_m3_s2 / radius**3,
            epoch_ns=config.epoch_ns,
        )

    def field(self, block: Block, window_s: float) -> FloatArray:
        """Return G (m, 3, 3) in B at a block's nodes: acceleration G s of an element at s [1/s^2].

        G = mu/R^3 (3 r r^T - 1). G is zero if the block has no attitude.
        """
        if not block.has_attitude:
            return np.zeros((len(block.t_ns), 3, 3))
        epoch_ns = self.epoch_ns
        if epoch_ns is None:  # window 0 starts at the epoch: the first SYNC
            centre_ns = (int(block.t_ns[0]) + int(block.t_ns[-1])) // 2
            epoch_ns = centre_ns - round((block.index + 0.5) * window_s * 1e9)
        angle = self.gradient_1_s2**0.5 * 1e-9 * (block.t_ns - epoch_ns).astype(np.float64)
        r_N = np.outer(np.cos(angle), self.r_hat) + np.outer(np.sin(angle), self.t_hat)
        r_B = np.einsum("mji,mj->mi", block.R_NB, r_N)
        G = self.gradient_1_s2 * (3.0 * r_B[:, :, None] * r_B[:, None, :] - np.eye(3))
        return np.asarray(G)
