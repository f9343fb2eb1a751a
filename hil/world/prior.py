"""The flight side's prior of an unknown body, drawn from the seed of a run.

The flight configuration has this prior and no truth of the body.
"""

import zlib
from dataclasses import dataclass

import numpy as np

from hil.world.inertia import FloatArray, is_physical
from hil.world.scenario import BODY_NAMES

PRIOR_STREAM = 71  # spawn key of the prior's draws, different from all devices' keys
OFF_RATIO = (0.3, 0.5)  # error of a prior relative to the value or its floor
SIGMA_RATIO = 0.5  # rms of this error relative to the prior: 0.4 / (1 -+ 0.4)
COM_FLOOR_RATIO = 0.3  # of the distance of the centre of mass from the origin
PRODUCT_FLOOR_RATIO = 0.1  # of the mean moment of inertia
MARGIN_RATIO = 0.02  # least margin of a prior's moments in the triangle inequality


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prior:
    """The flight side's prior of an unknown body: value and 1 sigma, (10,) each."""

    report: FloatArray
    sigma: FloatArray


def draw_prior(truth: FloatArray, seed: int, body: str) -> Prior:
    """Draw a physically consistent prior with errors of 30-50 % in every value, and its sigma.

    The error of a value is a random sign times 30-50 % of the value's size, or of a floor if the
    value is small (a component of the centre of mass, a product of inertia). A draw that no body
    of positive density can have is repeated. The sigma follows from the prior by the same rule,
    so it contains nothing of the truth.
    """
    place = BODY_NAMES.index(body) if body in BODY_NAMES else zlib.crc32(body.encode())
    key = (PRIOR_STREAM, place)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
    scale = _scale(truth)
    while True:
        off = rng.uniform(*OFF_RATIO, size=10) * rng.choice([-1.0, 1.0], size=10)
        report = truth + off * scale
        if is_physical(report, MARGIN_RATIO):
            return Prior(report=report, sigma=SIGMA_RATIO * _scale(report))


def _scale(report: FloatArray) -> FloatArray:
    """Return the size (10,) of each value to which its error is relative: magnitude or floor."""
    scale = np.abs(report)
    com = COM_FLOOR_RATIO * np.linalg.norm(report[1:4])
    product = PRODUCT_FLOOR_RATIO * np.mean(report[[4, 7, 9]])
    scale[1:4] = np.maximum(scale[1:4], com)
    scale[[5, 6, 8]] = np.maximum(scale[[5, 6, 8]], product)
    return np.asarray(scale)
