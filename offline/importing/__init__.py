"""`fsw import`: write a recording of this project from logs of other tools."""

from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path

from fsw.config import Config
from fsw.drivers.sources.devices import DEVICE_SAMPLES
from fsw.errors import ConfigError
from fsw.exchange.recording import SAMPLED, SAMPLES
from fsw.exchange.sinks import JOINTS
from fsw.service.recorder import open_recording
from offline.importing.captures import Channel, can_capture, serial_capture
from offline.importing.mapping import read_mapping
from offline.importing.samples import sampled_channels

PAIRS = {"--can": "BUS=FILE", "--serial": "DEVICE=FILE", "--shift": "NAME=SECONDS"}


def import_recording(
    arguments: Namespace, config: Config, progress: Callable[[str], None]
) -> list[str]:
    """Write the recording that the arguments of `fsw import` describe; return a line per channel.

    Raises
    ------
    ConfigError when the files do not fit the configuration or each other; nothing is written then.
    """
    out: Path = arguments.out
    channels = []
    progress("reading")
    for channel in chain(_captures(arguments, config), _sampled(arguments, config)):
        progress(f"read {channel.source}")
        channels.append(channel)
    _refuse_gaps(config, channels)
    _refuse_two_clocks(channels)
    if any(out.exists() and channel.source.samefile(out) for channel in channels):
        raise ConfigError(f"--out: {out} is read by this command; choose another name")
    progress(f"writing {out}")
    write(config, channels, out)
    return [
        line for c in channels for line in (f"{c.topic}: {c.text}, from {c.source}", *c.details)
    ]


def write(config: Config, channels: Sequence[Channel], out: Path) -> None:
    """Write a recording of the channels, with configuration and robot model attached.

    A recording of that name is replaced when the new one is complete.

    Raises
    ------
    ConfigError when the file cannot be written; an unfinished file is removed.
    """
    unfinished = out.with_name(f"{out.name}.unfinished")
    try:
        writer = open_recording(config, unfinished)
        try:
            writer.metadata("import", {c.topic: c.source.name for c in channels})
            if any(c.topic == f"{SAMPLES}{JOINTS}" for c in channels):
                names = " ".join(joint.name for joint in config.joints)
                writer.metadata(SAMPLED, {JOINTS: names})
            for channel in channels:
                channel.write(writer)
            writer.close()
            unfinished.replace(out)
        except BaseException:
            writer.abandon()
            unfinished.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise ConfigError(f"--out: {out} cannot be written: {error.strerror}") from error


def _captures(arguments: Namespace, config: Config) -> Iterator[Channel]:
    shifts = {name: _seconds(name, text) for name, text in _pairs("--shift", arguments)}
    buses = [bus.name for bus in config.buses]
    for name, file in _pairs("--can", arguments):
        _refuse_unknown("--can", name, buses)
        path, channel = _path_and_channel(file)
        yield can_capture(config, name, path, channel, shifts.pop(name, 0))
    for name, file in _pairs("--serial", arguments):
        _refuse_unknown("--serial", name, [own.name for own in config.sensors if own.bus is None])
        yield serial_capture(config, name, Path(file), shifts.pop(name, 0))
    if shifts:
        raise ConfigError(f"--shift: {', '.join(shifts)}: nothing of this name is imported")


def _sampled(arguments: Namespace, config: Config) -> Iterator[Channel]:
    if arguments.map is not None:
        mapping = read_mapping(arguments.map)
        yield from sampled_channels(config, mapping, arguments.map.parent, arguments.file)
    elif arguments.file is not None:
        raise ConfigError(f"{arguments.file}: needs --map, which says what its columns are")


def _pairs(option: str, arguments: Namespace) -> Iterator[tuple[str, str]]:
    for text in getattr(arguments, option.strip("-")):
        name, _, value = text.partition("=")
        if not value:
            raise ConfigError(f"{option} {text!r}: must be {PAIRS[option]}")
        yield name, value


def _seconds(name: str, text: str) -> int:
    """Return a text of seconds as nanoseconds; `name` is for the error message."""
    try:
        return round(float(text) * 1e9)
    except (ValueError, OverflowError) as error:
        raise ConfigError(f"--shift: {name}={text}: must be seconds") from error


def _path_and_channel(file: str) -> tuple[Path, str | None]:
    name, colon, channel = file.rpartition(":")
    return (Path(name), channel) if colon and not Path(file).exists() else (Path(file), None)


def _refuse_unknown(key: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        words = ", ".join(known) or "none"
        raise ConfigError(f"{key}: {name!r} is not in the configuration, which has: {words}")


def _refuse_gaps(config: Config, channels: Sequence[Channel]) -> None:
    """Raise ConfigError if a configured sensor has no channel, or two, or an unknown one has."""
    topics = [channel.topic for channel in channels]
    sampled = {topic.removeprefix(SAMPLES) for topic in topics if topic.startswith(SAMPLES)}
    devices = [name for name in DEVICE_SAMPLES if getattr(config, name)]
    known = {*(own.name for own in config.sensors), *devices, *[JOINTS] * bool(config.joints)}
    for line in sampled - known:
        raise ConfigError(f"--map: {line} is not in {config.name}")
    twice = {topic for topic in topics if topics.count(topic) > 1}
    if twice:
        raise ConfigError(f"{', '.join(sorted(twice))}: given twice")
    buses = [] if JOINTS in sampled else [bus.name for bus in config.buses]
    needed = {f"/can/{bus}": f"--can {bus}=FILE" for bus in buses}
    sensors = [own for own in config.sensors if own.name not in sampled and own.bus not in buses]
    lines = [own.name for own in sensors if own.bus is None]
    needed |= {f"/serial/{line}": f"--serial {line}=FILE" for line in lines}
    missing = [key for topic, key in needed.items() if topic not in topics]
    missing += [own.name for own in sensors if own.name not in lines]
    on_bus = config.actuators if buses else ()
    missing += [name for name in devices if name not in sampled and name not in on_bus]
    if missing:
        words = ", ".join(missing)
        raise ConfigError(f"{config.name} has sensors without a file: add {words}, or map them")


def _refuse_two_clocks(channels: Sequence[Channel]) -> None:
    """Raise ConfigError if two files have no time in common."""
    last = max(channels, key=lambda channel: int(channel.t_ns.min()))
    first = min(channels, key=lambda channel: int(channel.t_ns.max()))
    starts, ends = last.t_ns.min() * 1e-9, first.t_ns.max() * 1e-9
    if starts > ends:
        raise ConfigError(
            f"{last.source} begins at {starts:.3f} s, {first.source} ends at {ends:.3f} s: all "
            f"files must have one clock; see --shift"
        )
