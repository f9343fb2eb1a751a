"""A robot of the Python API: a validated configuration with the choices of the user.

This module imports no reader of recordings: a wrong configuration is reported before one is opened.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Literal, get_args
from weakref import finalize

from fsw.checks.configuration import validate
from fsw.config import Config
from fsw.config import load as load_config
from fsw.config.overlay_file import with_overlays
from fsw.errors import ConfigError

Method = Literal["mrnea", "rda", "cm", "ce", "fused"]
Weighting = Literal["ols", "wls", "eiv"]
Criterion = Literal["sigma", "d", "a", "e", "cond", "gamma"]


class Folder:
    """A folder for unpacked files that lives as long as this object."""

    def __init__(self) -> None:
        self.path = Path(mkdtemp(prefix="fsw-recording-"))
        finalize(self, rmtree, self.path, ignore_errors=True)


class Robot:
    """A validated configuration: robot, sensors, noise, priors.

    Parameters
    ----------
    config : path of a YAML file, or a configuration that is already loaded
    folder : folder with files that this robot needs while it exists; None: no such files
    """

    def __init__(self, config: Path | str | Config, *, folder: Folder | None = None) -> None:
        self.config = config if isinstance(config, Config) else load_config(Path(config))
        self._folder = folder
        _, warnings = validate(self.config)
        self.warnings: tuple[str, ...] = tuple(warnings)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of the configuration."""
        return tuple(joint.name for joint in self.config.joints)

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of the bodies to be identified."""
        return tuple(self.config.unknown)

    def with_overlays(self, *overlays: Path | str) -> Robot:
        """Return this robot with overlay files applied in order, such as `fsw calibrate` writes.

        Raises
        ------
        ConfigError with one line per fault.
        """
        if not overlays:
            return self
        config = with_overlays(self.config, [Path(path) for path in overlays])
        return Robot(config, folder=self._folder)

    def with_choices(
        self,
        *,
        method: Method | None = None,
        weighting: Weighting | None = None,
        unknown: str | None = None,
    ) -> Robot:
        """Return this robot with another method, weighting of mrnea or unknown bodies.

        `unknown` is base, target, both, or names with commas between.

        Raises
        ------
        ConfigError for a weighting without mrnea, an unknown body without a prior, or a method that
        this robot cannot have.
        """
        config, settings = self.config, self.config.estimator
        one_of("method", method, get_args(Method))
        one_of("weighting", weighting, get_args(Weighting))
        if weighting is not None and (method or settings.method) != "mrnea":
            raise ConfigError(f"--weighting {weighting}: only mrnea has one; add --method mrnea")
        changes = {"method": method if method != "ce" else None, "weighting": weighting}
        given = {key: value for key, value in changes.items() if value is not None}
        if any(getattr(settings, key) != value for key, value in given.items()):
            config = config.with_sections(estimator=settings.model_dump() | given)
        if not isinstance(unknown, str | None):
            raise ConfigError(f"unknown: {unknown!r} must be text: base, target, both or names")
        if unknown is not None and (bodies := bodies_named(unknown)) != self.unknown:
            config = config.with_unknown(bodies)
        return self if config is self.config else Robot(config, folder=self._folder)

    def __repr__(self) -> str:
        words = f"{len(self.joints)} joints, unknown {' and '.join(self.unknown)}"
        return f"Robot({self.config.name}: {words})"


def one_of(key: str, value: str | None, known: Sequence[str]) -> None:
    """Refuse a value that is not in `known`; None is accepted.

    Raises
    ------
    ConfigError that names key, value and the known values.
    """
    if value is not None and value not in known:
        raise ConfigError(f"{key}: {value!r} must be one of {', '.join(known)}")


def bodies_named(text: str) -> tuple[str, ...]:
    """Return the bodies of `base`, `target`, `both`, or of names with commas between.

    Raises
    ------
    ConfigError when the text contains no name.
    """
    names = "base,target" if text == "both" else text
    if bodies := tuple(name.strip() for name in names.split(",") if name.strip()):
        return bodies
    raise ConfigError(f"unknown: {text!r} must name a body")
