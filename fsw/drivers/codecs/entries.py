"""Find the codec of a serial device: by the name of an entry point, or by `package.module:Codec`.

The entry points of every installed package count, in the groups of `GROUPS`.
"""

from difflib import get_close_matches
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from inspect import Parameter, signature
from typing import Any, cast

from pydantic import ValidationError, create_model

from fsw.config import ImuConfig, Section, StarTrackerConfig
from fsw.config.text import explain
from fsw.drivers.codecs.attitude_datagram import StarTrackerCodec
from fsw.drivers.codecs.imu_datagram import ImuCodec
from fsw.errors import ConfigError, brief

IMU, STAR_TRACKER = "imu", "star_tracker"  # sections of the configuration
GROUPS = {IMU: "fsw.imu", STAR_TRACKER: "fsw.star_tracker"}
NEEDED = {
    IMU: ("title", "framer", "frame_bytes", "tick_s", "modulus", "decode", "lacks", "run"),
    STAR_TRACKER: ("title", "framer", "frame_bytes", "decode", "start"),
}
_LOADING = (ImportError, AttributeError, SyntaxError, TypeError, ValueError, LookupError, OSError)


@cache
def installed(kind: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a kind of device, in the order of their names."""
    return tuple(sorted(entry_points(group=GROUPS[kind]), key=lambda entry: entry.name))


def origin(entry: EntryPoint) -> str:
    """Return where a codec comes from: its path, and the package that offers it."""
    package = "" if entry.dist is None else f" of {entry.dist.name} {entry.dist.version}"
    return entry.value + package


def codec_class(kind: str, driver: str) -> type:
    """Return the class of a codec. Raises ConfigError unless there is exactly one."""
    key = f"{kind}.driver"
    if ":" in driver:
        found = [EntryPoint(driver, driver, GROUPS[kind])]
    else:
        found = [entry for entry in installed(kind) if entry.name == driver]
    if not found:
        names = [entry.name for entry in installed(kind)]
        close = get_close_matches(driver, names, n=1)
        hint = f"did you mean {close[0]!r}? " if close else ""
        listed = f"installed are {', '.join(names)}" if names else "no package offers any"
        old = "" if names else "; is fsw installed as it is now? run pip install again"
        raise ConfigError(
            f"{key}: {brief(driver)}; {hint}{listed}{old}; else the path package.module:Codec"
        )
    if len({entry.value for entry in found}) > 1:
        raise ConfigError(f"{key}: {driver!r} is ambiguous: {', '.join(map(origin, found))}")
    try:
        codec = found[0].load()
    except _LOADING as error:
        raise ConfigError(f"{key}: {brief(driver)} cannot be loaded: {error}") from error
    if not (isinstance(codec, type) and hasattr(codec, "decode")):
        raise ConfigError(f"{key}: {brief(driver)} is not a codec class")
    return codec


def options_of(codec: type) -> dict[str, Parameter]:
    """Return the options that a codec's constructor declares."""
    return dict(signature(codec, eval_str=True).parameters)


def imu_codec(config: ImuConfig) -> ImuCodec:
    """Return the codec of an inertial unit with its options. Raises ConfigError."""
    return cast(ImuCodec, _made(IMU, config))


def star_tracker_codec(config: StarTrackerConfig) -> StarTrackerCodec:
    """Return the codec of a star tracker with its options. Raises ConfigError."""
    return cast(StarTrackerCodec, _made(STAR_TRACKER, config))


def _made(kind: str, section: ImuConfig | StarTrackerConfig) -> object:
    codec = codec_class(kind, section.driver)
    declared = options_of(codec)
    keys = [name for name in declared if name in type(section).model_fields]
    fields: dict[str, Any] = {name: _field(option) for name, option in declared.items()}
    model = create_model("Options", __base__=Section, **fields)
    values = {name: getattr(section, name) for name in keys} | dict(section.options)
    try:
        options = model.model_validate(values)
        made: object = codec(**{name: getattr(options, name) for name in declared})
    except ValidationError as error:
        lines = explain(model, error)
        places = ["" if line.partition(":")[0] in keys else "options." for line in lines]
        texts = [f"{kind}.{at}{line}" for at, line in zip(places, lines, strict=True)]
        raise ConfigError("\n".join(texts)) from error
    except ValueError as error:
        raise ConfigError(f"{kind}.options: {error}") from error
    if missing := [name for name in NEEDED[kind] if not hasattr(made, name)]:
        words = f"is not a codec: no {', '.join(missing)}"
        raise ConfigError(f"{kind}.driver: {section.driver} {words}")
    return made


def _field(option: Parameter) -> tuple[Any, Any]:
    """Return type and default of an option as pydantic has them: `...` if it is required."""
    kind = Any if option.annotation is Parameter.empty else option.annotation
    return kind, ... if option.default is Parameter.empty else option.default
