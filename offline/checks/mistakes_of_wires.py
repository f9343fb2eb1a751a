"""Mistakes in the description of joints that only the dynamics show: units and scales."""

from collections.abc import Iterator
from functools import partial
from math import degrees, radians

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from offline.checks.mistake import DECADES, Mistake
from offline.checks.trial import Trial

WAYS = {  # factors that undo another unit of a position, and words on it
    "revolute": (
        (radians(1.0), f"angle is {degrees(1.0):.3g} times too large (degrees as rad?)"),
        (degrees(1.0), f"angle is {degrees(1.0):.3g} times too small (rad as degrees?)"),
    ),
    "prismatic": (
        (1e-3, "position is 1e+03 times too large (mm as m?)"),
        (1e3, "position is 1e+03 times too small (m as mm?)"),
    ),
}


def described_units(config: Config) -> Iterator[Mistake]:
    """Yield other units of one described joint, and another scale of its torque or of all."""
    own = [k for k, joint in enumerate(config.joints) if joint.driver == "described"]
    places = np.arange(len(config.joints))
    for k in own:
        joint, key = config.joints[k], f"joints.{k}.signals"
        for factor, words in WAYS[joint.kind]:
            yield Mistake(
                text=f"{key}.position ({joint.name}): its {words}; correct unit or scale",
                change=partial(Trial.reread, position=np.where(places == k, factor, 1.0)),
            )
    for which in [own, *([k] for k in own)] if len(own) > 1 else [own]:
        names = ", ".join(f"{config.joints[k].name}" for k in which)
        if any(config.joints[k].torque != "none" for k in which):
            yield Mistake(
                text=f"joints.{which[0]}.signals.torque ({names}): {{size}} (N m, "
                "mN m, per mille of the rated torque, gear ratio?); correct unit or scale",
                change=partial(_torques_divided, which=np.isin(places, which)),
                sizes=DECADES,
            )


def _torques_divided(trial: Trial, decades: float, which: NDArray[np.bool_]) -> Trial:
    return trial.reread(torque=np.where(which, 10.0**-decades, 1.0))
