"""Firings of thrusters along a motion."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from fsw.config import Config, NonNegative, Positive, Section
from fsw.errors import ConfigError

LONGEST_S = 1.0  # of each thruster without a plan


class Firing(Section):
    """One pulse of a thruster: its start [s] from the start of the motion, and its duration [s]."""

    thruster: str
    on_s: NonNegative
    for_s: Positive


def in_turn(config: Config, duration_s: float) -> tuple[Firing, ...]:
    """Return one firing of each thruster, one after the other."""
    step_s = duration_s / (len(config.thrusters) + 1)
    return tuple(
        Firing(thruster=own.name, on_s=step_s * (k + 0.5), for_s=min(LONGEST_S, 0.5 * step_s))
        for k, own in enumerate(config.thrusters)
    )


def of_strongest(config: Config, on_s: float, for_s: float) -> tuple[Firing, float] | None:
    """Return a firing of the strongest thruster and its force [N]; None: there is no thruster."""
    if not config.thrusters:
        return None
    own = max(config.thrusters, key=lambda thruster: thruster.force_n)
    return Firing(thruster=own.name, on_s=on_s, for_s=for_s), own.force_n


def by_device(firings: Sequence[Firing]) -> dict[str, list[tuple[float, float]]]:
    """Return start and duration [s] of the firings, by name of the thruster."""
    found: dict[str, list[tuple[float, float]]] = {}
    for own in firings:
        found.setdefault(own.thruster, []).append((own.on_s, own.for_s))
    return found


def check(path: Path, firings: Sequence[Firing], config: Config) -> None:
    """Raise ConfigError for a firing, in a file, of a thruster that the robot has not."""
    names = [own.name for own in config.thrusters]
    check_names(path, "firings", by_device(firings), names)


def check_names(path: Path, key: str, named: Iterable[str], names: Sequence[str]) -> None:
    """Raise ConfigError for a name at a key of a file that is not one of `names`."""
    for name in named:
        if name not in names:
            there = ", ".join(names) or "none configured"
            raise ConfigError(f"{path}: {key}: {name!r} is not one of them: {there}")
