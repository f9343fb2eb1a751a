"""The information of a trajectory about the unknown bodies, from the rows that the solver uses."""

from dataclasses import dataclass

import numpy as np

from fsw.messages import FloatArray
from planner import criteria
from planner.design import Grid
from planner.spline import Trajectory
from planner.subject import Subject
from planner.verify import free_layout


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Growth:
    """Predicted sigmas of the reported quantities during a motion."""

    t_s: FloatArray  # (m,)
    sigma: FloatArray  # (m, p)


def information_rows(subject: Subject, trajectory: Trajectory, rate_hz: float) -> FloatArray:
    """Return the whitened rows of every sample, times the square root of the time step.

    (m, r, s): m samples at `rate_hz`, r rows each, s states of the kernel.
    """
    layout, z = free_layout(trajectory)
    grid = Grid(layout, rate_hz)
    inputs = [*grid.motion(z), np.tile(subject.x[:, None], (1, grid.count))]
    X = np.asarray(subject.kernel.information(*inputs).full())
    X = X.reshape(len(X), grid.count, subject.kernel.states).transpose(1, 0, 2)
    return np.asarray(grid.step_s**0.5 * X)


def information_root(subject: Subject, trajectory: Trajectory, rate_hz: float) -> FloatArray:
    """Return a triangle R (s, s): R^T R is the information of the prior and of the motion."""
    X = information_rows(subject, trajectory, rate_hz)
    stacked = np.vstack([subject.prior_root, X.reshape(-1, X.shape[2])])
    return criteria.triangular_root(stacked)


def growth(subject: Subject, trajectory: Trajectory, rate_hz: float, step: int = 5) -> Growth:
    """Return the predicted sigmas after every `step` samples."""
    X = information_rows(subject, trajectory, rate_hz)
    root, times, sigmas = subject.prior_root, [0.0], [subject.scale.prior_sigma]
    for k in range(0, len(X), step):
        part = X[k : k + step]
        root = criteria.triangular_root(np.vstack([root, part.reshape(-1, X.shape[2])]))
        times.append(trajectory.duration_s * min(k + step, len(X)) / len(X))
        sigmas.append(np.sqrt(np.diag(criteria.report_covariance(root, subject.scale))))
    return Growth(t_s=np.array(times), sigma=np.array(sigmas))


def all_criteria(
    subject: Subject, trajectory: Trajectory, rate_hz: float, gamma: criteria.Gamma
) -> dict[str, float]:
    """Return every criterion by name as reported: exact, without logarithm and power mean."""
    values = fused_criteria(subject, information_root(subject, trajectory, rate_hz))
    layout, z = free_layout(trajectory)
    grid = Grid(layout, rate_hz)
    inputs = [*grid.motion(z), np.tile(subject.x[:, None], (1, grid.count))]
    J, tau = (np.asarray(out.full()) for out in subject.kernel.regressor(*inputs))
    stacked = J.reshape(-1, len(subject.x))
    values["cond"] = criteria.exact_condition(criteria.triangular_root(stacked))
    effort = grid.step_s * float(np.abs(tau).sum())
    values["gamma"] = gamma.xi1 * values["cond"] + gamma.xi2 / effort
    return values


def fused_criteria(subject: Subject, root: FloatArray) -> dict[str, float]:
    """Return the fused criteria of an information root by name, as reported."""
    values = {
        name: float(np.exp(criteria.fused(name, root, subject.scale).value))
        for name in ("sigma", "d", "a")
    }
    values["e"] = criteria.largest_sigma(root, subject.scale)
    return values
