"""The reasons why an estimate is not valid, from failed checks: one rule for recursion and batch.

Every reason that holds is published, the most severe first. A model that does not fit, or a body
that cannot exist, is shown by a converged estimate only: elsewhere residuals show the start. Where
the model explains so little that the estimate depends on how it was sought, this is the reason, and
what the estimate would say of prior, bodies and excitation is not judged.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from fsw.messages.false_alarms import sigmas

# squared distance, whitened, of a body from the consistent ones; noise moves a body at their border
# out of them along one direction
INCONSISTENT = sigmas("consistency") ** 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Failed:
    """Checks of an estimate; True: the check has failed.

    Attributes
    ----------
    aborted : the batch was stopped
    few_blocks : fewer blocks than an estimate needs before it may be valid
    reopened : the estimate was re-opened, and the blocks since then are too few to trust it
    not_converged : the iteration still moves the estimate
    misfit : many blocks do not fit the others, or residuals are larger than any sensor's noise
    mismatch : noise does not explain the residuals, or values of arm or calibration are implausible
    displaced : noise does not explain how far a body was moved to be physically possible
    prior_conflict : the data contradict the prior
    not_excited : the motion shows some combination of body parameters too little
    """

    aborted: bool = False
    few_blocks: bool = False
    reopened: bool = False
    not_converged: bool = False
    misfit: bool = False
    mismatch: bool = False
    displaced: bool = False
    prior_conflict: bool = False
    not_excited: bool = False


def reasons(failed: Failed) -> tuple[str, ...]:
    """Return why an estimate is not valid, the most severe reason first; empty: it is valid.

    Reasons that other failed checks make meaningless are left out; see the head of the module.
    """
    if failed.misfit:
        failed = Failed(aborted=failed.aborted, few_blocks=failed.few_blocks, mismatch=True)
    converged = not (failed.not_converged or failed.aborted)
    against = (
        (failed.aborted, "ABORTED"),
        (converged and failed.mismatch, "MODEL_MISMATCH"),
        (converged and failed.displaced, "NOT_CONSISTENT"),
        (failed.prior_conflict, "PRIOR_CONFLICT"),
        (failed.reopened, "REOPENED"),
        (failed.few_blocks, "TOO_FEW_BLOCKS"),
        (failed.not_converged, "NOT_CONVERGED"),
        (failed.not_excited, "INSUFFICIENT_EXCITATION"),
    )
    return tuple(reason for holds, reason in against if holds)


def is_displaced(squared_distances: Sequence[float]) -> bool:
    """Return whether a body is farther from the physically possible ones than noise explains.

    Parameters
    ----------
    squared_distances : per body, whitened by the covariance of its ten parameters
    """
    return max(squared_distances, default=0.0) > INCONSISTENT
