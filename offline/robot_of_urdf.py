"""Configuration of a robot by its URDF and choices in code, as `fsw init` writes it."""

from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from fsw.config import Config, parse
from fsw.config.consistency import NAMED_BY_PLACE
from fsw.config.feed import SAMPLES
from fsw.config.overlay_file import merged
from fsw.errors import ConfigError
from fsw.estimators.model.robot import RobotModel
from offline.arrays import Samples
from offline.init.arguments import add_arguments
from offline.init.command import RATE_HZ, described
from offline.init.devices import device
from offline.init.recording import Recorded

PLACES = ("imu_xyz", "imu_rpy", "tracker_rpy")  # settings may state others


def config_of_urdf(
    samples: Samples | None,
    urdf: Path,
    tool: str,
    unknown: Sequence[str],
    prior: Mapping[str, Mapping[str, Any]],
    flags: Mapping[str, str],
    settings: Mapping[str, Any],
) -> Config:
    """Return the configuration of a robot whose sensors are arrays.

    Parameters
    ----------
    samples : arrays that show rates, sizes and noise; None: usual rates, noise of the library
    prior : sections of `bodies` by body, whole or the keys that differ from `fsw init`'s guess
    flags : values of further flags of `fsw init`
    settings : other keys of the configuration

    Raises
    ------
    ConfigError with one line per fault.
    """
    for name in unknown:
        if name not in prior and name != "base":
            raise ConfigError(f"prior: {name!r} missing; it needs at least mass_kg")
    target = prior.get("target", {})
    if "target" in unknown and "mass_kg" not in target:
        raise ConfigError("prior: 'target' has no mass_kg; a guess is enough")
    placed = [name for name in unknown if name in NAMED_BY_PLACE]
    parser = ArgumentParser()
    add_arguments(parser)
    arguments = parser.parse_args([str(urdf)])
    answers = {
        "tool": tool,
        "unknown": "both" if len(placed) > 1 else (placed or ["base"])[0],
        "target_mass_kg": target.get("mass_kg", 1.0),
        **flags,
        **dict.fromkeys(PLACES, "0 0 0"),
    }
    for key, value in answers.items():
        setattr(arguments, key, value)

    def found_in(model: RobotModel) -> Recorded:
        has_imu = arguments.base != "clamped" or "imu" in settings
        has_tracker = "star_tracker" in settings
        usual = Recorded(
            rate_hz=RATE_HZ,
            imu_rate_hz=has_imu * float(device("imu", SAMPLES)["rate_hz"]),
            tracker_rate_hz=has_tracker * float(device("star_tracker", SAMPLES)["rate_hz"]),
        )
        found = usual if samples is None else samples.recorded(model)
        if has_imu and not found.imu_rate_hz:
            why = "settings have imu" if "imu" in settings else "only base='clamped' does without"
            raise ConfigError(f"samples: gyro_rad_s: missing; {why}")
        if has_tracker and not found.tracker_rate_hz:
            raise ConfigError("samples: q_NB_xyzw: missing; settings have star_tracker")
        arguments.imu = SAMPLES if found.imu_rate_hz else "none"
        arguments.tracker = SAMPLES if found.tracker_rate_hz else "none"
        return found

    text, _ = described(arguments, found_in)
    data = yaml.safe_load(text)
    bodies = {name: section for name, section in data["bodies"].items() if name in unknown}
    data |= {"unknown": list(unknown), "bodies": bodies | {k: {} for k in prior if k not in bodies}}
    name = f"Robot.from_urdf({urdf.name!r})"
    for key, above in (("bodies", {"bodies": prior}), ("settings", settings)):
        data = merged(data, above, f"{name}: {key}")
    source = yaml.safe_dump(data, sort_keys=False, allow_unicode=True).encode()
    return parse(source, urdf.parent, name)
