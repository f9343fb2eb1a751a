"""The newest values received from the loop, the estimator and the worker."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from fsw.config import Config
from fsw.errors import ConfigError
from fsw.messages import Block, Estimate
from fsw.messages.commands import JobReport
from fsw.telemetry.ports import Host
from fsw.telemetry.state import values as fields

if TYPE_CHECKING:
    from fsw.telemetry.state.residuals import TorqueResidual

NEVER_S = 1e6  # age of a value that was never received


class LatestValues:
    """Keeps the newest summary, estimate, residuals and job, and returns them as set values.

    Parameters
    ----------
    config : effective configuration
    """

    def __init__(self, config: Config, host: Host) -> None:
        self.config, self._host = config, host
        self._residuals: Any = None
        self._residuals_tried = False
        self._residual: list[TorqueResidual] = []
        self.status: Mapping[str, Any] = {}
        self._status_ns: int | None = None
        self.estimate: Estimate | None = None
        self._job: dict[str, Any] | None = None
        self._requested_job: tuple[str, tuple[str, ...]] = ("none", ())

    @property
    def summary_age_s(self) -> float:
        """Return the age of the loop's newest summary [s]; 1e6 before the first one."""
        if self._status_ns is None:
            return NEVER_S
        return (self._host.now_ns() - self._status_ns) * 1e-9

    def configure(self, config: Config) -> None:
        """Use another effective configuration from now on; discard the residuals."""
        self.config, self._residuals, self._residuals_tried = config, None, False
        self._residual = []

    def record_status(self, status: Mapping[str, Any]) -> None:
        """Record the loop's summary."""
        self.status, self._status_ns = status, self._host.now_ns()

    def record_block(self, block: Block) -> None:
        """Compute the torque residuals of a block with the newest estimate."""
        if self.estimate is None:
            return
        if not self._residuals_tried:
            self._residuals_tried = True
            self._residuals = _residuals(self.config)
        if self._residuals is not None:
            self._residual = self._residuals.of(block, self.estimate)

    def requested_job(self, method: str, bodies: tuple[str, ...]) -> None:
        """Record method and bodies of a requested batch job."""
        self._requested_job = (method, bodies)

    def record_job(self, report: JobReport) -> None:
        """Record progress or end of a batch job."""
        self._job = {
            "id": report.id,
            "state": report.state,
            "progress": report.progress,
            "text": report.text,
            "result": report.result,
        }

    def loop(self) -> dict[str, Any]:
        """Return the loop's values of housekeeping set 1."""
        return fields.loop_values(self.status, self.summary_age_s)

    def estimates(self) -> dict[str, Any]:
        """Return the values of housekeeping set 2, the online estimate."""
        joints = [joint.name for joint in self.config.joints]
        return fields.estimate_values(self.estimate, self._host.now_ns(), self._residual, joints)

    def covariance(self) -> dict[str, Any]:
        """Return the values of housekeeping set 3, the covariance."""
        return fields.covariance_values(self.estimate)

    def devices(self) -> dict[str, Any]:
        """Return the values of housekeeping set 4, the devices."""
        buses = [bus.name for bus in self.config.buses]
        joints = [joint.name for joint in self.config.joints]
        links = {own.name: own.bus for own in self.config.sensors if own.bus is not None}
        return fields.device_values(self.status, buses, joints, links)

    def job(self) -> dict[str, Any]:
        """Return the values of housekeeping set 5, the batch job."""
        return fields.job_values(self._job, *self._requested_job)

    def estimate_age_s(self) -> float:
        """Return the age of the newest data in the estimate [s]; 1e6 before the first estimate."""
        return NEVER_S if self.estimate is None else float(self.estimates()["age_s"])


def _residuals(config: Config) -> Any:  # noqa: ANN401
    from fsw.telemetry.state.residuals import TorqueResiduals  # loads pinocchio: only when needed

    try:
        return TorqueResiduals(config)
    except ConfigError:
        return None  # the robot cannot be read: there are no residuals
