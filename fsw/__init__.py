"""Flight software: the onboard inertial-parameter estimator of a free-floating space robot.

In a notebook: `from fsw import Robot, load, identify, replay, plan, report`; docs/api.md.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fsw.commands.api import Identification, Recording, identify, load, plan, replay, report
    from fsw.commands.robot import Robot

__all__ = ["Identification", "Recording", "Robot", "identify", "load", "plan", "replay", "report"]


def __getattr__(name: str) -> object:
    """Load the API at its first use: a flight process imports `fsw` and needs none of it."""
    if name not in __all__:
        raise AttributeError(f"module 'fsw' has no attribute {name!r}")
    return getattr(import_module("fsw.commands.api"), name)
