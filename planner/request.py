"""The planner's request and result, and the error when no motion keeps the limits."""

from dataclasses import dataclass

import numpy as np

from fsw.errors import ConfigError, FswError
from planner import criteria
from planner.spline import Trajectory
from planner.verify import Use

ROUNDS = 4
PAPER_GAMMA = criteria.Gamma(xi1=1.0, xi2=1e4)  # the paper gives no values


class InfeasibleError(FswError):
    """No trajectory keeps the limits; `uses` are the limits of the nearest one found."""

    def __init__(self, message: str, uses: list[Use]) -> None:
        super().__init__(message)
        self.uses = uses


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionRequest:
    """Settings of a plan; subject and limits are given separately."""

    criterion: criteria.Name = "sigma"
    gamma: criteria.Gamma = PAPER_GAMMA
    duration_s: float = 60.0
    knot_s: float = 2.5
    closed: bool = False
    starts: int = 1
    jobs: int = 1  # processes that compute starts in parallel
    candidates: int = 10  # random feasible motions per start, the best one is optimised
    iterations: int = 40
    rate_hz: float = 2.5
    seed: int = 0

    def __post_init__(self) -> None:
        """Raise ConfigError if a number is out of its range."""
        for key in (
            "duration_s",
            "knot_s",
            "starts",
            "jobs",
            "candidates",
            "iterations",
            "rate_hz",
        ):
            if not 0.0 < (value := getattr(self, key)) < np.inf:
                raise ConfigError(f"{key}: {value:g} must be positive")
        if self.seed < 0:
            raise ConfigError(f"seed: {self.seed} must not be negative")

    @property
    def evaluations(self) -> float:
        """Return roughly the largest number of evaluations of the criterion per process."""
        each = self.iterations + (ROUNDS - 1) * later(self.iterations)
        return float(np.ceil(self.starts / min(self.jobs, self.starts)) * each)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionPlan:
    """A trajectory that passed, its uses of the limits on the dense grid, the minimised value."""

    trajectory: Trajectory
    value: float
    uses: list[Use]
    rounds: int
    gradients: int
    starts: tuple[str, ...] = ()  # result of every start, in words


def shown(name: criteria.Name, value: float) -> float:
    """Return the criterion from the minimised value: its exponential, except for gamma."""
    return value if name == "gamma" else float(np.exp(value))


def later(iterations: int) -> int:
    """Return the number of iterations of each round after the first."""
    return max(8, iterations // 4)


def infeasible(text: str, uses: list[Use]) -> InfeasibleError:
    """Return the error with the exceeded limits, or with the first use if none is exceeded."""
    lines = [use.text() for use in uses if use.excess > 0] or [uses[0].text()]
    return InfeasibleError("\n  ".join([text, *lines]), uses)
