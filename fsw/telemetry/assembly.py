"""Builds the telemetry application from a configuration, with its keys and file delivery."""

import os
from contextlib import suppress

from file_delivery.entity import FileEntity
from file_delivery.numbers import Numbers
from fsw.config import Config
from fsw.errors import ConfigError
from fsw.telemetry.application import TelemetryApplication, build_context
from fsw.telemetry.link.security import Security
from fsw.telemetry.ports import Host

TRANSACTIONS_NAME = "transactions.number"  # file with the last transaction's number


def build_application(config: Config, host: Host, *, resume: bool) -> TelemetryApplication:
    """Build the application of a configuration; the link stays closed.

    Parameters
    ----------
    config : effective configuration
    resume : this process replaces a service process of the same loop that has died

    Raises
    ------
    ConfigError when keys or stored numbers cannot be used; the caller must then open no link.
    OSError when the state directory cannot be written.
    """
    telemetry = config.telemetry
    if telemetry is None:
        raise ConfigError("telemetry: missing")
    state = config.resolve(config.service.state_directory)
    files = state / telemetry.file_directory
    with suppress(OSError):  # the link opens with a bad disk too; `Filing` makes the folder later
        files.mkdir(parents=True, exist_ok=True)
    context = build_context(config, telemetry, host, resume=resume)
    security = None
    if telemetry.sdls is not None:
        security = Security(
            config, telemetry.sdls, state, os.environ, context.report, context.unix_s
        )
    numbers = Numbers(state / TRANSACTIONS_NAME)
    delivery = FileEntity(files, numbers.take, reserve_bytes=config.service.disk_reserve_bytes)
    return TelemetryApplication(context, delivery, security)
