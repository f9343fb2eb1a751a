"""`fsw install-service`: write a systemd unit that runs one configuration."""

import sys
from collections.abc import Sequence
from pathlib import Path

from fsw.config import Config
from fsw.errors import ConfigError, PortError

TEMPLATE = Path(__file__).with_name("inertia-daemon.service")
UNIT_NAME = "inertia-daemon.service"
FORBIDDEN = frozenset("\n\\\"' %{}")  # characters that would need quoting in a unit


def unit_text(config: Config, given: Sequence[Path], user: str, command: Path) -> str:
    """Return the unit that runs `given` (the configuration file, then overlays) as `user`.

    Raises
    ------
    ConfigError when a path or name is empty or contains a forbidden character.
    """
    folders = written_folders(config)
    path, *overlays = [file.absolute() for file in given]
    for word in (user, *map(str, (command, path, *overlays, *folders))):
        if not word or FORBIDDEN & set(word):
            raise ConfigError(f"{word!r}: is not possible in a systemd unit; use another name")
    return TEMPLATE.read_text(encoding="utf-8").format(
        command=command,
        config=" --overlay ".join(map(str, (path, *overlays))),
        folder=path.parent,
        user=user,
        writable=" ".join(f"-{folder}" for folder in folders),
    )


def written_folders(config: Config) -> list[Path]:
    """Return the folders in which the daemon writes."""
    folders = [config.resolve(config.service.state_directory)]
    if config.recorder.directory is not None:
        folders.append(config.resolve(config.recorder.directory))
    return folders


def install(config: Config, given: Sequence[Path], user: str, directory: Path) -> str:
    """Write the unit; return the commands that the user must run next, as root.

    Raises
    ------
    ConfigError as in `unit_text`; PortError when the directory cannot be written.
    """
    command = Path(sys.executable).with_name("fsw")
    text = unit_text(config, given, user, command)
    path = directory / UNIT_NAME
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise PortError(f"{path}: {error.strerror or error}") from error
    folders = " ".join(map(str, written_folders(config)))
    steps = [
        f"{path} is written; then, as root:",
        f"  id {user} || useradd --system --groups dialout {user}",
        f"  install -d -o {user} -g {user} {folders}",
        f"  systemctl daemon-reload && systemctl enable --now {UNIT_NAME}",
    ]
    return "\n".join(steps)
