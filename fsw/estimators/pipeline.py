"""The protocols of conditioning and estimation, and how the configured ones are made."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from fsw.config import Config
from fsw.estimators.conditioning.speed_motion import SpeedMotion
from fsw.messages import Block, Estimate, Window
from fsw.messages.findings import Finding


class BlockSource(Protocol):
    """Signal conditioning: windows to blocks."""

    def blocks(self, windows: Sequence[Window]) -> list[Block | None]:
        """Return the block of each window, None where it is unusable."""
        ...


class Estimator(Protocol):
    """The online estimator."""

    def push(self, block: Block) -> Estimate:
        """Fold in one block; return the estimate after it."""
        ...

    def work(self) -> None:
        """Do the work that is due before the next block, if there is any."""
        ...

    def finish(self) -> Estimate:
        """Settle completely; return the estimate."""
        ...

    def reset(self) -> None:
        """Return to the prior."""
        ...


@runtime_checkable
class Eventful(Protocol):
    """An estimator that has events to report."""

    def events(self) -> list[tuple[str, str, str]]:
        """Return severity, code and text of what happened since the last call."""
        ...


@runtime_checkable
class Gating(Protocol):
    """Signal conditioning that discards single implausible samples, and counts them."""

    outliers: int


@runtime_checkable
class Integrating(Protocol):
    """Signal conditioning that integrates speeds to angles, from window to window."""

    speeds: SpeedMotion


@runtime_checkable
class Screening(Protocol):
    """An estimator that leaves out channels of a block that do not fit."""

    def screened(self, block: Block) -> Block:
        """Return the newest block without the channels that screening has left out."""
        ...


@runtime_checkable
class Finder(Protocol):
    """Conditioning or an estimator that finds sensors at fault."""

    def findings(self) -> list[Finding]:
        """Return and discard the findings since the last call."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Pipeline:
    """Conditioning and estimation; replaced by fakes in tests of the wiring."""

    conditioner: BlockSource
    estimator: Estimator


def default_pipeline(config: Config, urdf_text: str | None = None) -> Pipeline:
    """Return the configured conditioning and online estimator.

    `urdf_text`, if given, replaces the robot's file. Raises ConfigError.
    """
    from fsw.estimators.conditioning.blocks import build_conditioner
    from fsw.estimators.model.building import robot_of
    from fsw.estimators.recursive.online import build_online

    model = robot_of(config, urdf_text)
    return Pipeline(
        conditioner=build_conditioner(config, model), estimator=build_online(config, model)
    )
