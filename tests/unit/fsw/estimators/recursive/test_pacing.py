"""How far a pass's point goes: passes that swing between two points settle between them."""

import numpy as np
import pytest

from fsw.estimators.recursive.pacing import Pacing


@pytest.mark.parametrize(("root", "settles"), [(np.eye(2), True), (None, False)])
def test_passes_that_swing_settle_half_way(root: np.ndarray | None, settles: bool) -> None:
    """Each pass throws the first state beyond the solution, as a bent cost does, the second not."""
    pacing, solution = Pacing(settled=False), np.array([1.0, -2.0])
    at = np.zeros(2)
    for _ in range(20):
        wanted = solution + np.array([-1.3, 0.1]) * (at - solution)
        at = pacing.point(wanted, at, root)
    assert (np.linalg.norm(at - solution) < 1e-6) == settles


def test_passes_that_converge_go_all_the_way() -> None:
    pacing, at = Pacing(settled=False), np.zeros(2)
    for _ in range(4):
        wanted = np.ones(2) + 0.5 * (at - np.ones(2))
        at = pacing.point(wanted, at, np.eye(2))
        np.testing.assert_array_equal(at, wanted)
