"""Values of the flags of `fsw init`, asked for on a terminal where a flag is missing."""

import argparse
import sys
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from math import isfinite
from typing import TypeVar

from fsw.config.base import MAX_MASS_KG
from fsw.config.sensors import MAX_ANGLE_RAD
from fsw.errors import ConfigError

T = TypeVar("T")


class Ask:
    """Returns the value of a flag, or asks for it if stdin is a terminal.

    Without a terminal, a missing flag is added to `missing`, and its default or stand-in is
    returned, so that one message can name all missing flags.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._arguments = arguments
        self.missing = list[tuple[str, str]]()  # flags and the words that ask for them

    def __call__(
        self, name: str, words: str, kind: Callable[[str], T], default: str = "", stand_in: str = ""
    ) -> T:
        """Return the value of flag `name`; `words` ask for it, `kind` converts the text."""
        value = getattr(self._arguments, name)
        flag = f"--{name.replace('_', '-')}"
        if value is not None:
            try:
                return kind(" ".join(map(str, value)) if isinstance(value, list) else str(value))
            except ValueError as error:
                raise ConfigError(f"{flag}: {error}") from error
        if not sys.stdin.isatty():
            self.missing.append((flag, words))
            return kind(default or stand_in)
        while True:
            try:
                answer = input(f"{words}{f', empty: {default}' if default else ''}: ") or default
            except EOFError as error:
                raise ConfigError(f"{flag}: missing; {words}") from error
            try:
                return kind(answer)
            except ValueError as error:
                sys.stderr.write(f"{flag}: {error}; try again\n")

    def require_all(self) -> None:
        """Raise ConfigError if flags are missing, with the words of the first and all names."""
        if self.missing:
            (flag, words), *others = self.missing
            too = f" (missing too: {', '.join(name for name, _ in others)})" if others else ""
            raise ConfigError(f"{flag}: missing; {words}{too}")


def three(text: str) -> list[float]:
    """Return three finite numbers."""
    values = [float(word) for word in text.replace(",", " ").split()]
    if len(values) != 3 or not all(map(isfinite, values)):
        raise ValueError(f"{text!r} must be three numbers")
    return values


def angles(text: str) -> list[float]:
    """Return three plausible angles [rad]."""
    turns = three(text)
    if any(abs(angle) > MAX_ANGLE_RAD for angle in turns):
        raise ValueError(f"{text!r} must be radians, each at most {MAX_ANGLE_RAD:g}")
    return turns


def one_of(known: Sequence[str]) -> Callable[[str], str]:
    """Return a function that returns a known name and raises ValueError for any other."""

    def read(text: str) -> str:
        if text not in known:
            close = get_close_matches(text, known, n=1)
            hint = f"; did you mean {close[0]}?" if close else ""
            raise ValueError(f"{text!r} must be one of {', '.join(known)}{hint}")
        return text

    return read


def mass_kg(text: str) -> float:
    """Return a positive mass [kg] within the bound of the configuration."""
    try:
        mass = float(text)
    except ValueError as error:
        raise ValueError(f"{text!r} must be a number of kg") from error
    if not 0.0 < mass <= MAX_MASS_KG:
        raise ValueError(f"{mass:g} must be positive and at most {MAX_MASS_KG:g} kg")
    return mass
