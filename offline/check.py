"""`fsw check`: judge a configuration, alone or together with a recording or a planned motion."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from file_delivery.extras import needs
from fsw.checks.configuration import missing_devices, validate
from fsw.checks.outputs import validate_outputs
from fsw.config import Config
from fsw.errors import ConfigError
from fsw.estimators.model.problem import Problem
from offline.describe import describe
from offline.progress import Progress
from planner.effects import told

YAML_ENDINGS = (".yaml", ".yml")


def check(config: Config, other: Path | None) -> tuple[str, bool]:
    """Return the text to print, and False if `other` is a recording that contradicts `config`.

    Raises
    ------
    ConfigError with one line per fault.
    """
    problem, warnings = validate(config)
    if other is not None and other.suffix not in YAML_ENDINGS:
        return _judged(other, config, problem)
    validate_outputs(config)
    if config.telemetry is not None:
        from fsw.telemetry.link.uplink_configuration import check_uplink

        warnings += check_uplink(config, os.environ)
    warnings += missing_devices(config)
    motion = None
    if other is not None:
        with planning("check PLAN"):
            from planner.motion import check_motion, loaded
        motion = loaded(other, config)
    lines = [
        describe(config, problem, told(config, problem, motion)),
        *(f"warning: {warning}" for warning in warnings),
    ]
    many = f"{len(warnings) or 'no'} warning{'s' if len(warnings) != 1 else ''}"
    lines.append(f"{config.name}: valid, {many}; no device was opened")
    if other is not None:
        lines += check_motion(config, other)
    return "\n".join(lines), True


def _judged(other: Path, config: Config, problem: Problem) -> tuple[str, bool]:
    """Return the findings in a recording or a CAN log with the verdict, and if the data agree."""
    from offline.check_recording import verdict_line  # imported late: it can open recordings

    lines, agree = _findings(other, config, problem)
    return "\n".join([*lines, verdict_line(other, config, agree)]), agree


def _findings(other: Path, config: Config, problem: Problem) -> tuple[list[str], bool]:
    from offline.check_log import as_recording, frame_findings, is_log, lacking
    from offline.check_recording import check_recording
    from offline.importing.tables import TABLES

    with Progress("check") as progress:
        if not is_log(other):
            return check_recording(other, config, problem, progress)
        try:
            if lacking(config):
                return frame_findings(other, config)
            with as_recording(other, config) as recording:
                return check_recording(recording, config, problem, progress)
        except ConfigError as error:
            if other.suffix.lower() not in TABLES:
                raise
            cure = "if it is a table, fsw import makes a recording of it"
            raise ConfigError(f"{error}; {cure}") from error


@contextmanager
def planning(command: str) -> Iterator[None]:
    """Turn an ImportError of the block into a ConfigError that names the extra to install."""
    try:
        yield
    except ImportError as error:
        raise ConfigError(needs(f"fsw {command}", str(error.name), "excite")) from error
