"""Apply changes to a configuration: uplinked tables, on-board parameters, unknown bodies."""

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import ValidationError

from fsw.config import Config, JointConfig, Section
from fsw.config.tables import ImuNoise, JointNoise, ModelNoise, NoiseTable, TrackerNoise
from fsw.config.text import explain
from fsw.errors import ConfigError

S = TypeVar("S", bound=Section)


def overlay(config: Config, changes: Mapping[str, Any]) -> Config:
    """Return the configuration with changes applied.

    Parameters
    ----------
    changes : `unknown`: bodies; `estimator`: keys of that section; `noise`: a noise table;
        `urdf`: path of another URDF; other keys, such as `urdf_text`, are ignored

    Raises
    ------
    ConfigError with one line per fault.
    """
    noise = noise_table(changes.get("noise", {}))
    unknown = tuple(changes.get("unknown", ())) or config.unknown
    bodies = {**config.bodies, **noise.bodies}
    for name in noise.bodies:
        was = config.bodies.get(name)
        if (None if was is None else was.frame) != bodies[name].frame:
            raise ConfigError(f"bodies.{name}.frame: must be as configured")
    for body in unknown:
        if body not in bodies or bodies[body].sigma is None:
            raise ConfigError(f"bodies.{body}: missing, or has no sigma; unknown lists {body!r}")
    sections: dict[str, Any] = {"unknown": unknown, "bodies": bodies}
    settings: dict[str, Any] = dict(changes.get("estimator", {}))
    settings |= noise.estimator.model_dump(exclude_none=True)
    sections["estimator"] = _laid(config.estimator, settings)
    sections["joints"] = _joints(config, noise)
    sections["imu"] = _laid(config.imu, noise.imu.model_dump(exclude_none=True))
    tracker = noise.star_tracker.model_dump(exclude_none=True)
    if config.star_tracker is not None:
        sections["star_tracker"] = _laid(config.star_tracker, tracker)
    elif tracker:
        raise ConfigError("star_tracker: the configuration has none")
    if changes.get("urdf"):
        sections["robot"] = _laid(config.robot, {"urdf": changes["urdf"]})
    return config.model_copy(update=sections)


def noise_of(config: Config) -> NoiseTable:
    """Return noise and priors of a configuration as a noise table."""
    return NoiseTable(
        joints={joint.name: _only(JointNoise, joint) for joint in config.joints},
        imu=_only(ImuNoise, config.imu),
        star_tracker=_only(TrackerNoise, config.star_tracker),
        estimator=_only(ModelNoise, config.estimator),
        bodies=dict(config.bodies),
    )


def _only(model: type[S], section: Section | None) -> S:
    """Return the keys of a section that the table `model` has; None: an empty table."""
    values = {} if section is None else {key: getattr(section, key) for key in model.model_fields}
    return model.model_validate(values)


def noise_table(values: object) -> NoiseTable:
    """Return plain values as a validated noise table. Raises ConfigError."""
    try:
        return NoiseTable.model_validate(values)
    except ValidationError as error:
        raise ConfigError("\n".join(explain(NoiseTable, error))) from error


def _joints(config: Config, noise: NoiseTable) -> tuple[JointConfig, ...]:
    names = [joint.name for joint in config.joints]
    unknown = sorted(set(noise.joints) - set(names))
    if unknown:
        raise ConfigError(f"joints: {unknown} are none of {names}")
    own = {name: item.model_dump(exclude_none=True) for name, item in noise.joints.items()}
    return tuple(_laid(joint, joint.named(own.get(joint.name, {}))) for joint in config.joints)


def _laid(section: S, changes: Mapping[str, Any]) -> S:
    if not changes:
        return section
    try:
        return type(section).model_validate({**section.model_dump(), **changes})
    except ValidationError as error:
        raise ConfigError("\n".join(explain(type(section), error))) from error
