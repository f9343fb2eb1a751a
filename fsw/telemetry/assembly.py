"""The telemetry application of a configuration: keys, numbers, file delivery, services."""

from __future__ import annotations

import os
from functools import partial

from file_delivery.entity import FileEntity
from file_delivery.numbers import Numbers
from fsw.config import Config
from fsw.messages.errors import ConfigError
from fsw.telemetry.application import TelemetryApplication
from fsw.telemetry.link.security import Security
from fsw.telemetry.ports import Host
from fsw.telemetry.services.eventing import SEVERITIES

TRANSACTIONS_NAME = "transactions.number"  # of the state directory: the number of the last one


def build_application(config: Config, host: Host, *, resume: bool) -> TelemetryApplication:
    """Put the application of a configuration together; opens no link.

    Parameters
    ----------
    resume : the service process goes on where one of the same loop has died

    Raises
    ------
    ConfigError when keys or kept numbers cannot be used; then there must be no link.
    OSError when the state directory cannot be written.
    """
    telemetry = config.telemetry
    if telemetry is None:
        raise ConfigError("telemetry: missing")
    state = config.resolve(config.service.state_directory)
    (state / telemetry.file_directory).mkdir(parents=True, exist_ok=True)
    security = None
    if telemetry.sdls is not None:
        security = Security(config, telemetry.sdls, state, os.environ, partial(_report, host))
    application = TelemetryApplication(
        config, config.as_read(), telemetry, host, security=security, resume=resume
    )
    transactions = Numbers(state / TRANSACTIONS_NAME)
    application.deliver_by(FileEntity(state / telemetry.file_directory, transactions.take))
    return application


def _report(host: Host, code: str, text: str) -> None:
    """Report an event of our own, with the severity the dictionary has for it."""
    host.report(SEVERITIES[code], code, text)
