"""Find faults of the folders that the daemon writes to."""

import os
from pathlib import Path

from fsw.config import Config
from fsw.config.telemetry import STATE_FOLDERS
from fsw.errors import ConfigError

MAX_SOCKET_PATH_BYTES = 107  # sun_path of Linux without its final zero
SOCKET_NAME_BYTES = 20  # room for a slash and the name of the control socket


def validate_outputs(config: Config) -> None:
    """Check that recordings and state can be written, and share their folders with nothing else.

    Raises
    ------
    ConfigError with one line per fault.
    """
    folders = {"service.state_directory": config.resolve(config.service.state_directory)}
    if config.recorder.directory is not None:
        folders["recorder.directory"] = config.resolve(config.recorder.directory)
    faults = [
        f"{key}: {folder} cannot be written: {why}"
        for key, folder in folders.items()
        if (why := _not_writable(folder))
    ]
    state = folders["service.state_directory"]
    used, bound = len(os.fsencode(state)), MAX_SOCKET_PATH_BYTES - SOCKET_NAME_BYTES
    if used > bound:
        faults.append(
            f"service.state_directory: {state} has {used} bytes; the control socket in it allows "
            f"at most {bound}"
        )
    faults += _foreign_faults(config, folders.get("recorder.directory"), state)
    if faults:
        raise ConfigError("\n".join(f"{config.name}: {fault}" for fault in faults))


def _foreign_faults(config: Config, recordings: Path | None, state: Path) -> list[str]:
    """Return a line if the recordings' folder, which telecommands reach, holds anything else."""
    if recordings is None:
        return []
    folder, state = recordings.resolve(), state.resolve()
    files = "files" if config.telemetry is None else config.telemetry.file_directory
    inside = [name for name in (*STATE_FOLDERS, files) if folder.is_relative_to(state / name)]
    held = {key: path for key, path in _own(config, state).items() if path.is_relative_to(folder)}
    words = [f"{key} {path}" for key, path in held.items()]
    words += [f"the daemon's own folder {state / name}" for name in inside]
    if not words:
        return []
    return [
        f"recorder.directory: {config.recorder.directory} holds {', '.join(words)}; must be a "
        "folder of its own, because telecommands read, move and delete what is in it"
    ]


def _own(config: Config, state: Path) -> dict[str, Path]:
    """Return the paths of the daemon's files and of its state, by what names them."""
    paths = {
        "the configuration": Path(Path(config.name).name),
        "robot.urdf": config.robot.urdf,
        "service.state_directory": state,
    }
    if config.excitation is not None:
        paths["excitation.limits"] = config.excitation.limits
    if config.telemetry is not None and config.telemetry.sdls is not None:
        for place, key in enumerate(config.telemetry.sdls.keys):
            if key.file is not None:
                paths[f"telemetry.sdls.keys.{place}.file"] = key.file
    return {key: config.resolve(path).resolve() for key, path in paths.items()}


def _not_writable(folder: Path) -> str:
    """Return the reason why a folder, existing or not yet, cannot be written; empty: it can."""
    nearest = folder
    while not nearest.exists() and nearest != nearest.parent:
        nearest = nearest.parent
    if not nearest.is_dir():
        return f"{nearest} is not a directory"
    if not os.access(nearest, os.W_OK | os.X_OK):
        return f"{nearest} does not permit it"
    return ""
