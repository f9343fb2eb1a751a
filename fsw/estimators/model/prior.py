"""What is known of the state before the data, of bodies in the quantities it is given in.

The prior of an unknown body is a Gaussian of its mass, centre of mass and central inertia. The
state holds first and second moments, which are products of these, so that the same knowledge is no
Gaussian of the state, and its linearisation at the prior's mean holds near it only. Where the data
leave a direction to the prior, as mass and inertia by one common factor when nothing but thrusters
gives a scale, the linearisation at a mean 40 % off acts as if it knew that factor. So the prior is
linearised where the estimate is, as the rows of the data are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fsw.estimators.model.inertia import from_parameters, report_jacobian
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import FloatArray

FAR = 4.0  # times the prior's mass or a part of it: too far off to be where the body is


@dataclass(frozen=True, eq=False)
class Prior:
    """A Gaussian of y(x), which moves as the state x does at the mean: y(mean) = mean, y' = 1.

    Of a body y is an affine function of its mass, centre of mass and central inertia; of all other
    states, and of a body whose mass is off by more than a factor FAR, it is the state itself: the
    centre of a body of no mass is a quotient of nothing, and a step too far is no estimate.
    """

    mean: FloatArray  # (p,)
    covariance: FloatArray  # (p, p) of the state at the mean
    bodies: tuple[slice, ...]  # ten states each

    def at(self, x: FloatArray) -> SquareRootInformation:
        """Return the information, linearised at a state (p,).

        Raises
        ------
        numpy.linalg.LinAlgError if the covariance is not positive definite.
        """
        known, (moved, Y) = self._known, self._moved(x)
        if Y is None:
            return known
        p, R = len(x), known.R @ Y
        empty = SquareRootInformation(np.zeros((p, p)), np.zeros(p))
        return empty.update(R, R @ x - known.R @ (moved - self.mean))

    def cost(self, x: FloatArray) -> float:
        """Return the squared distance of a state (p,) from the mean, in sigmas of y."""
        off = self._known.R @ (self._moved(x)[0] - self.mean)
        return float(off @ off)

    @cached_property
    def _known(self) -> SquareRootInformation:
        return SquareRootInformation.from_prior(self.mean, self.covariance)

    def _moved(self, x: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Return y(x) and its Jacobian (p, p); None: the identity."""
        y, Y = x, None
        for k in self.bodies:
            mean = self.mean[k]
            if np.array_equal(x[k], mean) or not _near(x[k][0], mean[0]):
                continue
            y, Y = (y.copy(), np.eye(len(x))) if Y is None else (y, Y)
            J = report_jacobian(mean)
            y[k] = mean + np.linalg.solve(J, _report(x[k]) - _report(mean))
            Y[k, k] = np.linalg.solve(J, report_jacobian(x[k]))
        return y, Y


def _near(mass_kg: float, mean_kg: float) -> bool:
    return bool(0.0 < mean_kg / FAR < mass_kg < mean_kg * FAR)


def _report(pi: FloatArray) -> FloatArray:
    mass, com, inertia = from_parameters(pi)
    return np.concatenate(([mass], com, inertia))
