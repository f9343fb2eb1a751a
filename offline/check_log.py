"""`fsw check CONFIG LOG`: a CAN log judged as the recording that `fsw import` makes of it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from fsw.config import Config
from fsw.config.text import kind_of
from fsw.errors import ConfigError
from fsw.exchange.sinks import CanTraffic
from offline.can_logs.reading import read_can_log
from offline.checks.wiring import Wires
from offline.importing import write
from offline.importing.captures import can_capture

HEAD_BYTES = 4096  # of a file, by which its kind is known


def is_log(path: Path) -> bool:
    """Return whether a file has content, and of no other kind that this project knows."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    return bool(head) and not kind_of(head)


def lacking(config: Config) -> list[str]:
    """Return the arguments of `fsw import` that a configuration needs besides one CAN log."""
    lines = [own.name for own in config.sensors if own.bus is None]
    others = [f"--can {bus.name}=FILE" for bus in config.buses[1:]]
    return [*others, *(f"--serial {line}=FILE" for line in lines)]


@contextmanager
def as_recording(log: Path, config: Config) -> Iterator[Path]:
    """Make a recording of a log of the configuration's only bus, for the time of the block.

    Raises
    ------
    ConfigError when the log cannot be used.
    """
    with TemporaryDirectory(prefix="fsw-check-") as folder:
        path = Path(folder) / f"{log.stem}.mcap"
        write(config, [can_capture(config, config.buses[0].name, log, None, 0)], path)
        yield path


def frame_findings(log: Path, config: Config) -> tuple[list[str], bool]:
    """Return what the frames of the first bus show alone, and whether they agree.

    Raises
    ------
    ConfigError when the log cannot be used.
    """
    if not config.buses:
        raise ConfigError(f"{log}: {config.name} has no bus")
    bus, wires = config.buses[0], Wires(config)
    wires.put(CanTraffic(bus.name, read_can_log(log).frames))
    lines, agree = wires.lines()
    needed = " ".join([f"--can {bus.name}={log}", *lacking(config)])
    words = f"signs, units and mounting are not judged by one log: fsw import {needed}"
    return [*lines, words], agree
