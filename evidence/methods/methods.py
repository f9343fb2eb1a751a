"""The methods of the study by name, run like the batch worker and `fsw identify` run them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fsw.config import Config
from fsw.estimators.batch.run import run_batch
from fsw.messages import Block
from hil.world.inertia import COUNT, FloatArray

CONSISTENT = ("mrnea eiv", "rda", "fused")  # methods whose mean NEES must be in its band
FUSED = "fused"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MethodOutcome:
    """The result of a method: status, and parameters x (10 b,) of the bodies with covariance."""

    status: str
    x: FloatArray
    covariance: FloatArray
    iterations: int
    bias_note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """A method, its weighting, and the channels of its own bound (see `fisher.information`)."""

    method: str
    weighting: str
    own: str


METHODS: Mapping[str, Method] = {
    "mrnea ols": Method(method="mrnea", weighting="ols", own="all"),
    "mrnea wls": Method(method="mrnea", weighting="wls", own="all"),
    "mrnea eiv": Method(method="mrnea", weighting="eiv", own="all"),
    "rda": Method(method="rda", weighting="eiv", own="rda"),
    "cm": Method(method="cm", weighting="eiv", own="cm"),
    "ce": Method(method="ce", weighting="eiv", own="torque"),
    FUSED: Method(method="fused", weighting="eiv", own="all"),
}


def with_estimator(config: Config, method: str, weighting: str = "eiv") -> Config:
    """Return the configuration with another online estimator."""
    chosen = config.estimator.model_copy(update={"method": method, "weighting": weighting})
    return config.model_copy(update={"estimator": chosen})


def on_blocks(name: str, blocks: Sequence[Block], config: Config) -> MethodOutcome:
    """Return the result of a method on blocks.

    Raises
    ------
    EstimatorError if the method has no result.
    """
    chosen = METHODS[name]
    settings = with_estimator(config, chosen.method, chosen.weighting)
    found = run_batch(settings, blocks, chosen.method, ())
    k = slice(0, COUNT * len(found["unknown"]))
    return MethodOutcome(
        status=found["status"],
        x=np.array(found["mean"])[k],
        covariance=np.array(found["covariance"])[k, k],
        iterations=found["iterations"],
        bias_note=found["note"],
    )
