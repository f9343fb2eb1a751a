"""A sensor out for most of a motion: the estimate stays honest and knows less by what it lost."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from evidence.fault_matrix import run, table
from hil.judge.score import normalised_error_squared
from hil.world.inertia import pi_of

BOUNDS = table.load().model_copy(update={"at_s": 3.0})
OUT_S = 13.0  # of 16 s of motion
SEED = 3


@pytest.fixture(scope="module")
def trunk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any]:
    setup = run.prepare(BOUNDS, SEED, tmp_path_factory.mktemp("trunk"))
    before = run.trunk(BOUNDS, setup)
    return before, run.branch(before, BOUNDS, None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "least"),
    [("acc_lost", 1.0), ("gyro_lost", 1.0), ("torque_fault", 1.02), ("node_power_cycle", 1.02)],
)
def test_what_is_lost_for_long_is_missing_in_the_covariance_and_in_nothing_else(
    trunk: Any, name: str, least: float
) -> None:
    """Free-floating, the joints alone tell of the base's motion: inertial sensors add little."""
    before, clean = trunk
    row = next(row for row in BOUNDS.faults if row.type == name)
    row = row.model_copy(update={"for_s": OUT_S, "at_s": None})
    flown = run.branch(before, BOUNDS, row)
    reference = run.branch(before, BOUNDS, row, reference=True)
    setup = before.setup
    truth = np.concatenate([pi_of(setup.scenario.truth[b]) for b in setup.scenario.unknown])
    final = flown.final
    nees = normalised_error_squared(final.x - truth, final.covariance)
    assert nees <= float(chi2.ppf(0.999, len(truth)))
    larger = flown.sigma / clean.sigma
    assert np.all(larger >= 0.999)
    assert np.max(larger) > least
    ratio = flown.sigma / reference.sigma
    assert 0.98 <= np.min(ratio) <= np.max(ratio) <= 1.05
    assert int(flown.status["health"]["incidents"][row.event]) == 1
