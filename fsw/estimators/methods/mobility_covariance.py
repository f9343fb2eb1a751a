"""Covariance of a batch on samples by way of the base's mobility."""

from __future__ import annotations

import numpy as np

from fsw.estimators.methods.result import invert
from fsw.estimators.methods.system import System
from fsw.estimators.model.mobility import Mapped, by_mobility
from fsw.messages import FloatArray
from fsw.messages.errors import EstimatorError


def through_mobility(x: FloatArray, information: FloatArray, system: System) -> Mapped | None:
    """Return the covariance of data information (p, p) and prior at x; None: no description.

    Torque is straight in the mobility. The momentum fixes the scale of base and target only
    together, which no such coordinates straighten: there the likelihood's profile is looked at.
    """
    if "base" not in system.problem.unknown:
        return None
    try:
        covariance = invert(information + system.prior_information)
        mapped = by_mobility(x, covariance, system.problem.body("base"))
    except (EstimatorError, np.linalg.LinAlgError):  # singular to working precision
        return None
    return mapped if mapped.holds else None
