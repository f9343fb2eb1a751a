"""Flight software: the onboard inertial-parameter estimator of a free-floating space robot.

In a notebook, use `from fsw import Robot, Samples, identify`; `dir(fsw)` lists the names that
docs/api.md describes.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from offline.api import (
        Findings,
        Identification,
        Recording,
        check,
        identify,
        load,
        plan,
        replay,
        report,
    )
    from offline.arrays import Samples
    from offline.robot import Robot

__all__ = [
    "Findings",
    "Identification",
    "Recording",
    "Robot",
    "Samples",
    "check",
    "identify",
    "load",
    "plan",
    "replay",
    "report",
]


def __getattr__(name: str) -> object:
    """Import an API name at its first use, so that flight processes do not load the API."""
    if name not in __all__:
        raise AttributeError(f"module 'fsw' has no attribute {name!r}")
    return getattr(import_module("offline.api"), name)


def __dir__() -> list[str]:
    """Return the names of the API, whether they have been imported yet or not."""
    return sorted(__all__)
