"""Forces on the base that valves switch, as known inputs of unknown scale, delay and rise time.

A valve that opens at t_e makes the force rise as h(t) = 1 - exp(-(t - t_e - d) / r); one that
closes lets it fall likewise. The channels of a block are projections of samples on polynomials of
degree m - 1, and a force that rises within the window is no such polynomial. So the same projection
of the force is used at the nodes,

    u = P[sum of +-h],    U = P[integral of +-h],

both in closed form, with exact derivatives by d and r. With the j-fold integrals of h at s after
its start, I_0 = h and I_(j+1) = s^(j+1)/(j+1)! - r I_j, partial integration gives

    integral of p h = sum over j of (-1)^j p^(j) I_(j+1).
"""

from dataclasses import dataclass
from functools import lru_cache
from math import factorial

import numpy as np
from numpy.polynomial import legendre

from fsw.messages import Block, FloatArray

LEAST_RISE_RATIO = 0.1  # least rise time over the configured one, at states far from their prior
TAIL_RISES = 10.0  # rise times after which a force counts as settled


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Shares of K nominal forces in a block; first axis: value, derivatives by delay, rise time."""

    u: FloatArray  # (3, m, K) share at the nodes
    U_s: FloatArray  # (3, m, K) its integral from the window's start
    whole_s: FloatArray  # (3, K) integral of u over the window
    before_s: FloatArray  # (K,) integral up to the window's start


@dataclass(frozen=True, slots=True, eq=False)
class Switched:
    """K forces on the base."""

    ways: FloatArray  # (6, K) nominal force [N], moment about the base's origin [N m], in B
    delay_s: FloatArray  # (K,)
    rise_s: FloatArray
    window_s: float
    of_force: slice | None  # states of their groups; None: exact
    of_delay: slice | None
    of_rise: slice | None

    def __len__(self) -> int:
        """Return the number of forces."""
        return len(self.delay_s)

    @property
    def is_exact(self) -> bool:
        """Whether no force is in doubt."""
        return self.of_force is None

    @property
    def tail_s(self) -> FloatArray:
        """Return the time (K,) from a change of the valve to the settled force [s]."""
        return np.asarray(self.delay_s + TAIL_RISES * self.rise_s, np.float64)

    def changes(self, block: Block) -> bool:
        """Return whether a force changes in a block; the channels are then not polynomials."""
        return len(self) > 0 and changes(block.edges, self.tail_s, -0.5 * self.window_s)

    def profile(self, block: Block, x: FloatArray) -> Profile:
        """Return the forces at the nodes, for delays and rise times of a state."""
        K, m, half_s = len(self), len(block.t_ns), 0.5 * self.window_s
        edges = block.edges[block.edges[:, 2] != 0.0]
        owner, t_s, sign = edges[:, 0].astype(np.intp), edges[:, 1], edges[:, 2]
        delay, rise = self.delay_s.copy(), self.rise_s.copy()
        if self.of_delay is not None:
            delay += x[self.of_delay]
        if self.of_rise is not None:
            rise = np.maximum(rise + x[self.of_rise], LEAST_RISE_RATIO * rise)
        to_nodes, ends = _projection(m)
        r = rise[owner] / half_s
        start = (t_s + delay[owner]) / half_s  # in half windows from the centre
        folds, by_r = _integrals(np.maximum(np.array([-1.0, 1.0])[:, None] - start, 0.0), r, m + 2)
        by_d = np.zeros_like(folds)
        by_d[1:] = -folds[:-1]  # that of I_0 is not needed
        alternating = (-1.0) ** np.arange(m)
        per_edge = np.zeros((2, 3, m, len(edges)))
        wholes, before = np.zeros((3, len(edges))), np.zeros(len(edges))
        for which, integral in enumerate((folds, by_d, by_r)):
            for order in (1, 2):
                terms = integral[order : order + m] * alternating[:, None, None]  # (j, end, edge)
                at_ends = np.einsum("kjb,jbe->kbe", ends, terms)
                per_edge[order - 1, which] = at_ends[:, 1] - at_ends[:, 0]
            # minus a constant, so that the integral is zero at the window's start
            per_edge[1, which, 0] -= 2.0 * integral[1, 0]
            wholes[which] = integral[1, 1] - integral[1, 0]
        # difference from the commanded one
        before = folds[1, 0] - np.maximum(-1.0 - t_s / half_s, 0.0)
        of = np.zeros((len(edges), K))
        of[np.arange(len(edges)), owner] = sign
        scale = np.array([1.0, 1.0 / half_s, 1.0 / half_s])
        u, U = to_nodes @ (per_edge @ of)
        return Profile(
            u=u * scale[:, None, None],
            U_s=half_s * U * scale[:, None, None],
            whole_s=half_s * scale[:, None] * (wholes @ of),
            before_s=block.opened_s + half_s * (before @ of),
        )

    def wrench(self, u: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return force and moment about the base's origin in base axes (m, 6), and d/dx (m, 6, p).

        `u` (3, m, K): shares of the nominal forces, or impulses, with derivatives as in `Profile`.
        """
        J, gain = np.zeros((u.shape[1], 6, len(x))), np.ones(len(self))
        if self.of_force is not None:
            J[:, :, self.of_force] = self.ways * u[0][:, None]
            gain = gain + x[self.of_force]
        scaled = self.ways * gain
        if self.of_delay is not None:
            J[:, :, self.of_delay] = scaled * u[1][:, None]
        if self.of_rise is not None:
            J[:, :, self.of_rise] = scaled * u[2][:, None]
        return u[0] @ scaled.T, J


def changes(edges: FloatArray, tail_s: FloatArray, start_s: float) -> bool:
    """Return whether a force changes after start_s; the channels are then not polynomials.

    `tail_s` (K,): time from a change of a valve to the settled force [s].
    """
    used = edges[edges[:, 2] != 0.0]
    return bool(np.any(used[:, 1] + tail_s[used[:, 0].astype(np.intp)] > start_s))


@lru_cache(maxsize=8)
def _projection(nodes: int) -> tuple[FloatArray, FloatArray]:
    """Return maps (m, m) of Legendre moments to the nodes, and (m, m, 2) p^(j)(+-1).

    The latter are the derivatives j = 0 .. m - 1 of every polynomial at -1 and 1.
    """
    points = legendre.leggauss(nodes)[0]
    to_nodes = legendre.legvander(points, nodes - 1) * (np.arange(nodes) + 0.5)
    ends = np.empty((nodes, nodes, 2))
    for k in range(nodes):
        for j in range(nodes):
            ends[k, j] = legendre.legval([-1.0, 1.0], legendre.legder(np.eye(nodes)[k], j))
    return to_nodes, ends


def _integrals(s: FloatArray, r: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the j-fold integrals of h at s >= 0 after its start (count, ...), and d/dr."""
    folds, by_r = np.zeros((2, count, *s.shape))
    fading = np.exp(-s / r)
    folds[0], by_r[0] = 1.0 - fading, -(s / r**2) * fading
    for j in range(1, count):
        folds[j] = s**j / factorial(j) - r * folds[j - 1]
        by_r[j] = -folds[j - 1] - r * by_r[j - 1]
    return folds, by_r
