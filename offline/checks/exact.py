"""What an error in a constant that is taken as exact would do to a body's mass."""

import numpy as np

from fsw.config import ImuConfig, JointConfig
from fsw.estimators.measurement.row_functions import Linearisation, watched_rows
from fsw.estimators.model.inertia import PARAMETERS
from fsw.estimators.model.state_group import StateGroup
from fsw.estimators.model.state_groups import GROUPS
from offline.checks.trial import Trial

USUAL = 1e-3  # of a scale, or rad: an error of a constant whose doubt has no default


def exact_risks(trial: Trial) -> list[str]:
    """Return a line for each constant of joints and inertial unit that is taken as exact.

    It says by how much an error as large as the default doubt moves the mass of a body that is
    fitted to the trial: the worst label of each group. An error e in the column g of a constant
    moves the estimate by P A^T g e.
    """
    problem, watched = trial.problem, trial.problem.watched
    function = watched_rows(problem)
    if watched is None or function is None or not trial.blocks:
        return []
    mean = trial.fit().mean
    rows = Linearisation(function, trial.blocks)(mean)
    A = np.concatenate([one.A for one in rows])
    G = np.concatenate([one.watched for one in rows if one.watched is not None])
    P = problem.prior.at(mean).update(A, A @ mean).covariance()
    masses = range(problem.bodies.start, problem.bodies.stop, PARAMETERS)
    moved_kg = np.abs((P @ A.T @ G)[masses])
    lines, names = [], watched.names
    for group in GROUPS:
        own = [k for k, name in enumerate(names) if name.startswith(f"{group.name}.")]
        if group.name in problem.places or not (own and group.is_exact_if_absent):
            continue
        body, k = np.unravel_index(int(np.argmax(moved_kg[:, own])), (len(masses), len(own)))
        label, size = names[own[k]].partition(".")[2], _doubt(group)
        error = f"{size:g} {group.unit}".rstrip()
        lines.append(
            f"{group.cause or group.effect} taken as exact: {error} of {label} moves the mass of "
            f"{problem.unknown[body]} by {moved_kg[body, own[k]] * size:.2g} kg ({group.key})"
        )
    return lines


def _doubt(group: StateGroup) -> float:
    """Return the default doubt of a group's constants."""
    model = JointConfig if group.section == "joints" else ImuConfig
    return model.model_fields[group.field].default or USUAL
