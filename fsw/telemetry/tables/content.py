"""Reads, validates and writes contents of tables, without any effect on the daemon."""

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import yaml
from pydantic import ValidationError

from fsw.config import Config, Section
from fsw.config.overlay import noise_of, overlay
from fsw.config.tables import MonitorsTable, NoiseTable, RatesTable
from fsw.config.text import explain, read_yaml
from fsw.errors import ConfigError, unforeseen
from fsw.telemetry.dictionary.codes import Table
from fsw.telemetry.services.housekeeping import science_fault
from fsw.telemetry.services.monitors import check_table

SUFFIX = {Table.ROBOT: "urdf", Table.NOISE: "yaml", Table.RATES: "yaml", Table.MONITORS: "yaml"}
S = TypeVar("S", bound=Section)


def read_table(model: type[S], content: bytes) -> S:
    """Return the table in a YAML text. Raises ConfigError with one line per fault."""
    values = read_yaml(content)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise ConfigError("\n".join(explain(model, error))) from error


def validate_table(config: Config, table: Table, content: bytes) -> None:
    """Check a table; a robot or noise table in a copy of the configuration, with one update.

    Raises
    ------
    ConfigError with one line per fault, or with the text of an unforeseen error.
    OSError if the robot's file cannot be written for the check.
    """
    try:
        _validate(config, table, content)
    except (ConfigError, OSError, MemoryError):
        raise
    except Exception as error:
        raise ConfigError(f"cannot be used: {unforeseen(error)}") from error


def _validate(config: Config, table: Table, content: bytes) -> None:
    from fsw.checks.configuration import validate

    if not content:
        return  # an empty content stands for the configuration as it was read
    if table is Table.RATES:
        _check_rates(config, read_table(RatesTable, content))
    elif table is Table.MONITORS:
        check_table(read_table(MonitorsTable, content))
    elif table is Table.NOISE:
        validate(overlay(config, noise_changes(content)))
    else:
        with TemporaryDirectory(prefix="fsw-table-") as folder:
            path = Path(folder) / "robot.urdf"
            path.write_bytes(content)
            validate(overlay(config, {"urdf": path}))


def _check_rates(config: Config, table: RatesTable) -> None:
    intervals_s = {sid: rate.interval_s for sid, rate in table.sets.items()}
    telemetry = config.telemetry
    fault = "" if telemetry is None else science_fault(intervals_s, telemetry.science_rate_hz)
    if fault:
        raise ConfigError(f"sets: {fault}")


def noise_changes(content: bytes) -> dict[str, Any]:
    """Return a noise table as changes to the configuration. Raises ConfigError."""
    table = read_table(NoiseTable, content) if content else NoiseTable()
    return {"noise": table.model_dump(mode="json", exclude_none=True)}


def configured_noise(config: Config) -> bytes:
    """Return the noise of a configuration as the YAML of a noise table."""
    return to_yaml(noise_of(config).model_dump(mode="json", exclude_none=True))


def to_yaml(values: Mapping[str, Any]) -> bytes:
    """Return plain values as YAML."""
    return yaml.safe_dump(dict(values), sort_keys=False).encode()
