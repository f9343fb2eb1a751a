"""Checks before a restart that the daemon would start again, and open its link."""

import os
from pathlib import Path

from fsw.config import Config, load
from fsw.config.overlay_file import with_overlays
from fsw.errors import CommandError, ConfigError
from fsw.messages.commands import Code


def check_start(config: Config) -> None:
    """Read the files of a running configuration again and check them as a start does.

    Raises
    ------
    CommandError FAILED with the first fault: a start would end with it, or open no link.
    """
    from fsw.checks.configuration import validate, validate_ports
    from fsw.checks.outputs import validate_outputs
    from fsw.telemetry.link.uplink_configuration import check_uplink

    first, *overlays = map(Path, config.files)
    try:
        found = with_overlays(load(first), overlays)
        for check in (validate, validate_ports, validate_outputs):
            check(found)
        check_uplink(found, os.environ)
    except ConfigError as error:
        fault = str(error).splitlines()[0]
        raise CommandError(Code.FAILED, f"the daemon would not start again: {fault}") from error
