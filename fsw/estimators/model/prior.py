"""The prior of the state, which is Gaussian in the quantities that the configuration gives.

The prior of an unknown body is a Gaussian of its mass, centre of mass and central inertia. The
state holds first and second moments, which are products of these. The same prior is therefore not
Gaussian in the state, and its linearisation at the prior's mean holds only near that mean. Where
only jets give a scale, the data leave one direction to the prior: a common factor on mass and
inertia. A linearisation at a mean 40 % off then acts as if that factor were known. So the prior is
linearised at the estimate, as the rows of the data are.

Where torques of a held arm come from currents, a common factor on all masses and the inverse factor
on all gains leave every prediction as it is. Errors of links and friction cost less at small
masses than at large ones. Were they Gaussian for themselves, their sum would therefore draw all
masses, the payload's too, towards zero. So they are Gaussian in the reading's scale, where the
factor does not change them: their product with the gain 1 + s.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fsw.estimators.model.inertia import from_parameters, report_jacobian
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import FloatArray

IndexArray = NDArray[np.intp]
FAR = 4.0  # largest factor between a mass and the prior's at which the prior is re-linearised


@dataclass(frozen=True, eq=False)
class Prior:
    """A Gaussian of y(x), scaled so that y(mean) = mean and dy/dx = 1 at the mean.

    For a body, y is an affine function of its mass, centre of mass and central inertia. For a state
    in the reading's scale, y is affine in its product with the gain. For all other states y = x;
    also for a body whose mass is off by more than a factor FAR, because its
    centre of mass is not defined near zero mass, and such a step is too long to be an estimate.
    """

    mean: FloatArray  # (p,)
    covariance: FloatArray  # (p, p) of the state at the mean
    bodies: tuple[slice, ...]  # the ten states of each unknown body
    read: IndexArray = field(default_factory=lambda: np.empty(0, np.intp))  # in its scale
    gains: FloatArray = field(default_factory=lambda: np.empty((0, 0)))  # (k, p) of torque scales

    def at(self, x: FloatArray) -> SquareRootInformation:
        """Return the information of the prior, linearised at a state x (p,).

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
        """Return the squared distance of y(x) from the mean, in sigmas of y, at a state x (p,)."""
        off = self._known.R @ (self._moved(x)[0] - self.mean)
        return float(off @ off)

    @cached_property
    def _known(self) -> SquareRootInformation:
        return SquareRootInformation.from_prior(self.mean, self.covariance)

    def _moved(self, x: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Return y(x) (p,) and its Jacobian (p, p); None for the Jacobian: the identity."""
        y, Y = x, None
        if len(self.read) and not np.array_equal(x, self.mean):
            own, off = self.read, (x - self.mean)[self.read]
            at_mean = 1.0 + self.gains @ self.mean
            gain = (1.0 + self.gains @ x) / at_mean
            y, Y = x.copy(), np.eye(len(x))
            y[own] = self.mean[own] + off * gain
            Y[own] = (off / at_mean)[:, None] * self.gains
            Y[own, own] = gain
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
