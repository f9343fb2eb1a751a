"""A robot of the Python API: a validated configuration with the choices of the user.

This module imports no reader of recordings: a wrong configuration is reported before one is opened.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any, Literal, get_args
from weakref import finalize

import numpy as np

from fsw.checks.configuration import validate
from fsw.config import Config
from fsw.config import load as load_config
from fsw.config.overlay_file import with_overlays
from fsw.errors import ConfigError, brief
from offline.calls import errors_in_calls

if TYPE_CHECKING:
    from offline.arrays import Samples

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
    fit : returns the configuration with rates and noise of arrays; None: the configuration has them
    """

    def __init__(
        self,
        config: Path | str | Config,
        *,
        folder: Folder | None = None,
        fit: Callable[[Samples], Config] | None = None,
    ) -> None:
        self.config = config if isinstance(config, Config) else load_config(Path(config))
        self._folder, self._fit = folder, fit
        _, warnings = validate(self.config)
        self.warnings: tuple[str, ...] = tuple(warnings)

    @classmethod
    def from_urdf(
        cls,
        urdf: Path | str,
        *,
        tool: str,
        unknown: str | Sequence[str] = "target",
        prior: Mapping[str, Mapping[str, Any]] | None = None,
        base: Literal["free", "planar", "clamped"] = "free",
        torque: str | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> Robot:
        """Return the robot of a URDF whose sensors are arrays (`Samples`), without a file.

        Rates and noise are those of the arrays it is used with; delays are zero.

        Parameters
        ----------
        tool : link that grasps
        unknown : base, target, both, or names of bodies
        prior : by body, keys of `bodies` in a configuration; a target needs at least `mass_kg`;
            None: the base alone is unknown, and its prior is the root link of the URDF
        base : what holds the base: nothing, a level table, a bench
        torque : what measures torque, of `fsw init list`; None: arm_sensor if clamped, else generic
        settings : other keys of a configuration, such as `{"imu": {"mounting": {...}}}`

        Raises
        ------
        ConfigError with one line per fault.
        """
        from offline.robot_of_urdf import config_of_urdf  # reads recordings

        if str(urdf).lstrip().startswith("<"):
            raise ConfigError("urdf: is the text of a URDF; must be its path")
        one_of("base", base, ("free", "planar", "clamped"))
        sections = prior.values() if isinstance(prior, Mapping) else [prior]
        if prior is not None and not all(isinstance(own, Mapping) for own in sections):
            words = "must be a dict of bodies, {'target': {'mass_kg': ...}}"
            raise ConfigError(f"prior: {brief(prior)} {words}")
        names = bodies_named(unknown) if isinstance(unknown, str) else tuple(unknown)
        flags = {"base": base} | ({} if torque is None else {"torque": torque})
        fit = partial(
            config_of_urdf,
            urdf=Path(urdf).absolute(),
            tool=tool,
            unknown=names,
            prior=plain(prior or {}),
            flags=flags,
            settings=plain(settings or {}),
        )
        with errors_in_calls():
            return cls(fit(None), fit=fit)

    def fitted(self, samples: Samples) -> Robot:
        """Return this robot with rates and noise of the arrays, if it is one of `from_urdf`."""
        with errors_in_calls():
            return self if self._fit is None else Robot(self._fit(samples), folder=self._folder)

    def _with(self, change: Callable[[Config], Config]) -> Robot:
        """Return this robot with a changed configuration, whatever arrays it is used with."""
        config, fit = change(self.config), self._fit
        if config is self.config:
            return self
        later = None if fit is None else lambda samples: change(fit(samples))
        return Robot(config, folder=self._folder, fit=later)

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
        return self._with(lambda config: with_overlays(config, [Path(path) for path in overlays]))

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
        one_of("method", method, get_args(Method))
        one_of("weighting", weighting, get_args(Weighting))
        if weighting is not None and (method or self.config.estimator.method) != "mrnea":
            raise ConfigError(f"--weighting {weighting}: only mrnea has one; add --method mrnea")
        if not isinstance(unknown, str | None):
            raise ConfigError(f"unknown: {unknown!r} must be text: base, target, both or names")
        changes = {"method": method if method != "ce" else None, "weighting": weighting}
        given = {key: value for key, value in changes.items() if value is not None}
        bodies = None if unknown is None else bodies_named(unknown)

        def change(config: Config) -> Config:
            settings = config.estimator
            if any(getattr(settings, key) != value for key, value in given.items()):
                config = config.with_sections(estimator=settings.model_dump() | given)
            if bodies is not None and bodies != tuple(config.unknown):
                config = config.with_unknown(bodies)
            return config

        return self._with(change)

    def __repr__(self) -> str:
        words = f"{len(self.joints)} joints, unknown {' and '.join(self.unknown)}"
        return f"Robot({self.config.name}: {words})"


def plain(value: object) -> Any:  # noqa: ANN401
    """Return a value with the numbers and arrays of NumPy as those of Python."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(own) for key, own in value.items()}
    return [plain(own) for own in value] if isinstance(value, list | tuple) else value


def named(value: object) -> str:
    """Return a value for a message: a path as it is, anything else by its kind."""
    return repr(value) if isinstance(value, str | Path) else f"a {type(value).__name__}"


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
