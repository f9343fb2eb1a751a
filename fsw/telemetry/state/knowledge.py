"""What the service has heard from the loop, the estimator and the worker, newest first-hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from fsw.config import Config
from fsw.messages import Block, Estimate
from fsw.messages.commands import JobReport
from fsw.messages.errors import ConfigError
from fsw.telemetry.state import values as fields

if TYPE_CHECKING:
    from fsw.telemetry.state.residuals import TorqueResidual

NEVER_S = 1e6  # age of what was never heard


class Knowledge:
    """The newest summary, estimate, residuals and job."""

    def __init__(self, config: Config, now_ns: Callable[[], int]) -> None:
        self._config, self._now_ns = config, now_ns
        self._residuals: Any = None
        self._residuals_tried = False
        self._residual: list[TorqueResidual] = []
        self.status: Mapping[str, Any] = {}
        self._status_ns: int | None = None
        self.estimate: Estimate | None = None
        self._job: dict[str, Any] | None = None
        self._asked: tuple[str, tuple[str, ...]] = ("none", ())

    @property
    def summary_age_s(self) -> float:
        """Return the age of the loop's newest summary."""
        if self._status_ns is None:
            return NEVER_S
        return (self._now_ns() - self._status_ns) * 1e-9

    def configured(self, config: Config) -> None:
        """Take another configuration."""
        self._config, self._residuals, self._residuals_tried = config, None, False
        self._residual = []

    def heard_status(self, status: Mapping[str, Any]) -> None:
        """Take a summary."""
        self.status, self._status_ns = status, self._now_ns()

    def heard_block(self, block: Block) -> None:
        """Take a window: what of its torques the newest estimate leaves unexplained."""
        if self.estimate is None:
            return
        if not self._residuals_tried:
            self._residuals_tried = True
            self._residuals = _residuals(self._config)
        if self._residuals is not None:
            self._residual = self._residuals.of(block, self.estimate)

    def asked(self, method: str, bodies: tuple[str, ...]) -> None:
        """Remember what a batch job was asked for."""
        self._asked = (method, bodies)

    def heard_job(self, report: JobReport) -> None:
        """Take progress or end of a batch job."""
        self._job = {
            "id": report.id,
            "state": report.state,
            "progress": report.progress,
            "text": report.text,
            "result": report.result,
        }

    def loop(self) -> dict[str, Any]:
        """Return the loop's part of set 1."""
        return fields.loop_values(self.status, self.summary_age_s)

    def estimates(self) -> dict[str, Any]:
        """Return set 2."""
        joints = [joint.name for joint in self._config.joints]
        return fields.estimate_values(self.estimate, self._now_ns(), self._residual, joints)

    def covariance(self) -> dict[str, Any]:
        """Return set 3."""
        return fields.covariance_values(self.estimate)

    def devices(self) -> dict[str, Any]:
        """Return set 4."""
        buses = [bus.name for bus in self._config.buses]
        joints = [joint.name for joint in self._config.joints]
        return fields.device_values(self.status, buses, joints)

    def job(self) -> dict[str, Any]:
        """Return set 5."""
        return fields.job_values(self._job, *self._asked)

    def estimate_age_s(self) -> float:
        """Return the age of the newest data used."""
        return NEVER_S if self.estimate is None else float(self.estimates()["age_s"])


def _residuals(config: Config) -> Any:  # noqa: ANN401
    from fsw.telemetry.state.residuals import TorqueResiduals  # pinocchio: only once it is needed

    try:
        return TorqueResiduals(config)
    except ConfigError:
        return None  # the loop runs on fakes, or the file has gone; there is nothing to compare
