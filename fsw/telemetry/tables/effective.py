"""The effective configuration: the file's values changed by uploaded tables and parameters."""

import os
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

from file_delivery.durable import rename_file, write_file
from fsw.config import Config
from fsw.config.overlay import overlay
from fsw.errors import ConfigError
from fsw.telemetry.dictionary.codes import Table
from fsw.telemetry.state.parameter_values import estimator_changes, stored_values
from fsw.telemetry.state.store import GenerationStore
from fsw.telemetry.tables.content import noise_changes, validate_table

TABLES, PARAMETERS, BOOT = "tables", "parameters", "boot"  # folders in the state directory
ROBOT_FILE = "robot_{:08x}.urdf"  # with the CRC-32 of the content, so each robot has its own file


def effective_config(config: Config) -> Config:
    """Return the effective configuration at the start; invalid stored tables are left out.

    Stored tables and parameters are read only if the configuration has a telemetry link.
    Raises OSError if an uploaded robot model cannot be written to its file.
    """
    if config.telemetry is None:
        return config
    state = config.resolve(config.service.state_directory)
    for table in (Table.ROBOT, Table.NOISE):
        for generation in GenerationStore(state / TABLES / table.name.lower()).read()[0]:
            try:
                validate_table(config, table, generation.content)
            except ConfigError:
                continue  # reported by the service, which reads the same files
            config = laid_over(config, state, table, generation.content)
            break
    _remove_robots(state, config)
    values, _ = stored_values(GenerationStore(state / PARAMETERS))
    return overlay(config, {"estimator": estimator_changes(values)})


def laid_over(config: Config, state: Path, table: Table, content: bytes) -> Config:
    """Return the configuration changed by a robot or noise table. Raises ConfigError, OSError."""
    if not content:
        return config
    changes: dict[str, Any]
    if table is Table.NOISE:
        changes = noise_changes(content)
    else:
        changes = {"urdf": write_robot(state, content)}
    return overlay(config, changes)


def write_robot(state: Path, content: bytes) -> Path:
    """Write an uploaded robot model to its file; return the absolute path. Raises OSError."""
    folder = state / TABLES
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / ROBOT_FILE.format(zlib.crc32(content))
    temporary = path.with_suffix(f".{os.getpid()}")  # loop and service may write at the same time
    write_file(temporary, content)
    rename_file(temporary, path)
    return path.absolute()


def _remove_robots(state: Path, config: Config) -> None:
    """Remove the files of uploaded robot models that the configuration does not use."""
    in_force = config.resolve(config.robot.urdf).absolute()
    for path in (state / TABLES).glob(ROBOT_FILE.replace("{:08x}", "*")):
        if path.absolute() != in_force:
            with suppress(OSError):  # a later start removes it
                path.unlink()
