"""The joints' motion as one function: what a block knows of its end, the next one begins with.

Positions and rates of the joints are continuous from window to window. The fit of a window's angles
gives both at the window's edges, with the errors e of the fit: E_start e and E_end e. Torques and
rates show these errors too, r = noise - D e, so that a block knows its end better than by angles
alone. The next block has the difference at their common edge as further rows:

    c = E_start z - s0(x) = E_start e - e0,    cov e = Sigma, cov e0 = P

with s0 and P mean and covariance of the end before, given all blocks since the last gap and the
state x. So the rows of a run of blocks are those of the whole run, with its motion unknown, block
by block: a Kalman filter of the motion besides the state, whose derivative by the state is carried
too. The rows of the edge come last, so that the whitened rows of the nodes are those without them.
Residuals far beyond noise show that the state is far off, and the motion with it. On a base
that is held, torques hold friction that no state explains and that outlasts a window; there, every
block is alone.
Source: Kailath, Sayed, Hassibi, Linear Estimation (2000), sec. 9.2.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtrs

from fsw.estimators.conditioning.polynomial import EXTRA_DEGREE
from fsw.estimators.conditioning.truncation import OMITTED, coefficients
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.impulse import Impulse, span_ns
from fsw.estimators.measurement.motion_noise import smoothed
from fsw.estimators.measurement.mrnea import Rows, whitened
from fsw.messages import FloatArray, IntArray

NOISE_POWER = 100.0  # mean squared whitened residual; above it the state is far off, not the motion
FAR_OFF = 3.0  # power of the excess over it by which a motion handed on is less certain
ADJOINING_NS = 1000  # windows that are farther apart share no motion


@lru_cache(maxsize=8)
def edge_operator(nodes: int, half_s: float) -> FloatArray:
    """Return (4, 3, m): position and rate at start, then at end, by [qd, qdd, q] at m nodes."""
    degree = min(nodes - 1 + EXTRA_DEGREE + OMITTED, 3 * nodes - 1)  # as many as values
    edge = np.array([-1.0, 1.0])
    value = legendre.legvander(edge, degree)
    unit = np.eye(degree + 1)
    slope = np.stack([legendre.legval(edge, legendre.legder(one)) for one in unit], axis=1)
    wanted = np.stack([value, slope / half_s], axis=1).reshape(4, -1)
    found: FloatArray = np.einsum("fc,cdi->fdi", wanted, coefficients(nodes, degree, half_s))
    found.setflags(write=False)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    """Positions and rates of B blocks' n joints at both edges, by their fits.

    The 2 n values of an edge are position and rate, joint by joint.
    """

    kept: IntArray  # which of the 2 n values are joined: no angle that is the integral of a speed
    value: FloatArray  # (B, 2, 2 n) at start and end
    by_motion: FloatArray  # (B, n, 3 m, 4) covariance of the motion with the edges
    cov: FloatArray  # (B, 2, 2 n, 2, 2 n)
    rows: FloatArray  # (B, k, 2, 2 n) covariance of the rows with the edges


def _edges(s: BlockStack, D: FloatArray, half_s: float) -> _Edges:
    B, m, n = len(s.blocks), s.m, s.n
    d, r = D.shape[0], D.shape[2]
    E = edge_operator(m, half_s)
    z = np.stack([s.by_block(v) for v in (s.qd_rad_s, s.qdd_rad_s2, s.q_rad)])  # 3, B, m, n
    value = np.einsum("fdi,dbij->bfj", E, z).reshape(B, 2, 2, n)
    G = s.cov_joint @ E.reshape(4, -1).T
    V = (E.reshape(4, -1) @ G).reshape(B, n, 2, 2, 2, 2)
    joined = np.ones((n, 2), np.bool_)
    if s.walk_rad2.size:
        joined[:, 0] = ~(s.walk_rad2 > 0.0).any(axis=0)
    cov, k = np.zeros((B, 2, n, 2, 2, n, 2)), np.arange(n)
    cov[:, :, k, :, :, k] = V.transpose(1, 0, 2, 3, 4, 5)
    by_order = G.reshape(B, n, 3, m, 4)[:, :, :d]
    M = -np.einsum("dbirj,bjdif->birfj", D.reshape(d, B, m, r, n), by_order)
    return _Edges(
        kept=np.flatnonzero(joined),
        value=value.transpose(0, 1, 3, 2).reshape(B, 2, 2 * n),
        by_motion=G,
        cov=cov.reshape(B, 2, 2 * n, 2, 2 * n),
        rows=M.reshape(B, m * r, 2, 2, n).transpose(0, 1, 2, 4, 3).reshape(B, m * r, 2, 2 * n),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """The rows of a block and of the edge before it, whitened."""

    root: FloatArray  # (k, k) lower
    by_end: FloatArray  # (k, 2 n) covariance with the errors of the end
    b: FloatArray  # (k,)
    edge: int  # rows of the edge
    end: FloatArray  # (2 n,) position and rate
    cov: FloatArray  # (2 n, 2 n)


class Joined:
    """Blocks whose motion is joined at their edges, given the residuals at the measured motion.

    Parameters
    ----------
    D : (d, N, r, n) gains of the channels in use by [qd, qdd], and by q where angles are noisy
    S : (B, k, k) covariance of the blocks' rows, k = m r
    r : (N, r) residuals
    x : (p,) the state
    before : what the block before has handed on
    joins : whether the motion is joined; else every block is alone
    """

    def __init__(
        self,
        s: BlockStack,
        D: FloatArray,
        S: FloatArray,
        r: FloatArray,
        x: FloatArray,
        window_s: float,
        before: Impulse | None,
        *,
        joins: bool,
    ) -> None:
        self._s, self._D, self._x, self._before, self._found = s, D, x, before, list[_Block]()
        self._spans = [span_ns(block, window_s) for block in s.blocks]
        residuals, n = r.reshape(len(s.blocks), -1), s.n
        self._edges = _edges(s, D, 0.5 * window_s) if joins and s.has_angles else None
        start: tuple[FloatArray, FloatArray] | None = None
        if before is not None and n and len(before.motion) == 2 * n:
            adjoins = abs(self._spans[0][0] - before.end_ns) <= ADJOINING_NS
            start = (before.motion_at(x), before.cov_motion) if adjoins else None
        last_ns = self._spans[0][0]
        for k, (own, root) in enumerate(zip(residuals, S, strict=True)):
            if self._edges is None or abs(self._spans[k][0] - last_ns) > ADJOINING_NS:
                start = None
            self._found.append(_joined(self._edges, k, root, own, start))
            start, last_ns = (self._found[-1].end, self._found[-1].cov), self._spans[k][1]

    @property
    def likeliest(self) -> BlockStack:
        """The blocks with the likeliest motion, given their rows and the edges before them."""
        s, edges = self._s, self._edges
        B, r = len(s.blocks), self._D.shape[2]
        weighted, by_edge = np.zeros((B, s.m * r)), np.zeros((B, s.n, 3 * s.m, 1))
        for k, own in enumerate(self._found):
            found = dtrtrs(own.root, own.b, lower=1, trans=1)[0] if len(own.b) else own.b
            weighted[k] = found[: s.m * r]
            if own.edge and edges is not None:
                drawn = np.zeros(2 * s.n)
                drawn[edges.kept] = found[-own.edge :]
                by_edge[k] = edges.by_motion[k, :, :, :2] @ drawn.reshape(s.n, 2, 1)
        return smoothed(s, self._D, weighted.reshape(B * s.m, r), by_edge)

    def rows(
        self, X: FloatArray, each: tuple[Impulse | None, ...], use: NDArray[np.bool_]
    ) -> list[Rows]:
        """Return the whitened rows for the columns X (B, k, p); `each`: what they hand on."""
        found, before, p = list[Rows](), self._before, len(self._x)
        for k, (own, gained) in enumerate(zip(self._found, each, strict=True)):
            columns = X[k]
            if own.edge and before is not None and self._edges is not None:
                columns = np.concatenate([columns, before.J_motion[self._edges.kept]])
            A, _ = whitened(own.root, columns, own.b)
            before = gained
            if self._edges is not None:
                none = Impulse(self._spans[k][1], np.zeros(3), np.zeros((3, p)), self._x)
                J = own.by_end.T @ A
                before = replace(gained or none, motion=own.end, J_motion=J, cov_motion=own.cov)
            found.append(Rows(A, own.b, before, own.root, use, edge=own.edge))
        return found


def _joined(
    edges: _Edges | None,
    k: int,
    S: FloatArray,
    r: FloatArray,
    start: tuple[FloatArray, FloatArray] | None,
) -> _Block:
    if edges is None:
        L = np.asarray(np.linalg.cholesky(S), np.float64)
        W, b = whitened(L, np.zeros((len(r), 0)), r)
        return _Block(L, W, b, 0, np.zeros(0), np.zeros((0, 0)))
    by_end, edge = edges.rows[k, :, 1], 0
    if start is not None:
        (mean, cov), kept = start, edges.kept
        C, edge = edges.rows[k, :, 0, kept].T, len(kept)
        V = (edges.cov[k, 0, :, 0] + cov)[np.ix_(kept, kept)]
        S = np.block([[S, C], [C.T, V]])
        r = np.concatenate([r, (edges.value[k, 0] - mean)[kept]])
        by_end = np.concatenate([by_end, edges.cov[k, 0, kept, 1]])
    L = np.asarray(np.linalg.cholesky(S), np.float64)
    W, b = whitened(L, by_end, r)
    end = edges.value[k, 1] - W.T @ b
    cov = edges.cov[k, 1, :, 1] - W.T @ W
    power = float(b @ b) / max(len(b), 1)
    return _Block(L, W, b, edge, end, cov * max(1.0, power / NOISE_POWER) ** FAR_OFF)
