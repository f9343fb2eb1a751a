"""The telemetry application of a configuration: keys, numbers, file delivery, services."""

from __future__ import annotations

import os

from file_delivery.entity import FileEntity
from fsw.config import Config, TelemetryConfig
from fsw.messages.errors import ConfigError
from fsw.telemetry.application import TelemetryApplication
from fsw.telemetry.link.sdls import FrameReceiver
from fsw.telemetry.link.sdls_keys import load_associations
from fsw.telemetry.link.sdls_numbers import NUMBERS_NAME, NumberStore
from fsw.telemetry.ports import Host

RUN_BITS = 4  # transactions of successive runs begin so far apart


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
    numbers, receiver = None, None
    if telemetry.sdls is not None:
        numbers = NumberStore(state / NUMBERS_NAME)
        receiver = frame_receiver(config, telemetry, numbers)
    application = TelemetryApplication(
        config, config.as_read(), telemetry, host, receiver=receiver, numbers=numbers, resume=resume
    )
    first = application.boot.count << RUN_BITS
    application.deliver_by(FileEntity(state / telemetry.file_directory, first))
    return application


def frame_receiver(
    config: Config, telemetry: TelemetryConfig, numbers: NumberStore
) -> FrameReceiver | None:
    """Return the receiver of authenticated frames. Raises ConfigError."""
    sdls = telemetry.sdls
    if sdls is None:
        return None
    return FrameReceiver(
        load_associations(config, sdls, os.environ),
        numbers,
        spacecraft_id=sdls.spacecraft_id,
        virtual_channel=sdls.virtual_channel,
        window=sdls.window,
    )
