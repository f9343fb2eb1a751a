"""The square-root information filter: a triangular factor and its right-hand side.

The filter holds R x = z, the triangular form of all information so far. New rows A x = c are folded
in by one orthogonal factorisation, so the information is positive semidefinite by construction.
Source: Bierman, Factorization Methods for Discrete Sequential Estimation (1977), ch. V.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtpqrt, dtrtri, dtrtrs

from fsw.errors import EstimatorError
from fsw.messages import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SquareRootInformation:
    """Information R^T R about a state with R x = z; immutable, updates return a new one."""

    R: FloatArray  # (p, p) upper triangular
    z: FloatArray  # (p,)

    @staticmethod
    def from_prior(mean: FloatArray, covariance: FloatArray) -> SquareRootInformation:
        """Return the information of a Gaussian prior.

        Raises
        ------
        numpy.linalg.LinAlgError if the covariance is not positive definite.
        """
        L = np.linalg.cholesky(covariance)
        root = solve_triangular(L, np.eye(len(mean)), lower=True)
        R = np.linalg.qr(root).R
        return SquareRootInformation(R, R @ mean)

    def update(self, A: FloatArray, c: FloatArray) -> SquareRootInformation:
        """Return this information with the whitened rows A x = c, A (k, p), folded in.

        LAPACK's dtpqrt factorises the triangle above the new rows in one call; below the diagonal
        it leaves the zeros.
        """
        p = len(self.z)
        top = np.zeros((p + 1, p + 1), order="F")
        top[:p, :p], top[:p, p] = self.R, self.z
        rows = np.empty((len(c), p + 1), order="F")
        rows[:, :p], rows[:, p] = A, c
        factor = dtpqrt(0, min(32, p + 1), top, rows, overwrite_a=1, overwrite_b=1)[0]
        return SquareRootInformation(factor[:p, :p].copy(), factor[:p, p].copy())

    def mean(self) -> FloatArray:
        """Return the state estimate.

        Raises
        ------
        EstimatorError if the information is singular or not finite.
        """
        self._check()
        mean: FloatArray = dtrtrs(self.R, self.z)[0]
        return mean

    def covariance_root(self) -> FloatArray:
        """Return R^-1: covariance = R^-1 R^-T. Raises EstimatorError if singular or not finite."""
        self._check()
        root: FloatArray = dtrtri(self.R)[0]
        return root

    def covariance(self) -> FloatArray:
        """Return the covariance (p, p), symmetric. Raises EstimatorError if singular."""
        root = self.covariance_root()
        return root @ root.T

    def whitened(self, A: FloatArray, innovation: FloatArray) -> FloatArray:
        """Return the innovation of rows A with unit noise, whitened by its own covariance.

        Raises EstimatorError if singular or not finite.
        """
        AS = A @ self.covariance_root()
        if len(AS) == 0:
            return innovation
        unit = np.eye(len(innovation))
        try:
            L = np.linalg.cholesky(unit + AS @ AS.T)
        except np.linalg.LinAlgError:  # AS is so large that rounding loses the unit
            L = np.linalg.qr(np.concatenate([unit, AS.T])).R.T
        white: FloatArray = dtrtrs(L, innovation, lower=1)[0]
        return white

    def scaled_condition_number(self) -> float:
        """Return the condition number of R with every column scaled to unit length."""
        scale = np.linalg.norm(self.R, axis=0)
        return float(np.linalg.cond(self.R / scale))

    def _check(self) -> None:
        diagonal = np.abs(np.diag(self.R))
        if not (np.all(np.isfinite(self.R)) and np.all(np.isfinite(self.z))):
            raise EstimatorError("information is not finite")
        if diagonal.min() == 0.0:
            raise EstimatorError("information is singular: some combination is not observable")
