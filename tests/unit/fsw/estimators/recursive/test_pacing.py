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


def passes(count: int, *, knows_misfit: bool) -> list[float]:
    """Return the misfit of each pass for x in `4 arctan(x)`, measured as 0, from a start at 3.

    Whole Gauss-Newton steps diverge from any start beyond 1.39: x - (1 + x^2) arctan(x).
    """
    pacing, at, found = Pacing(settled=False), np.array([3.0]), []

    def misfit() -> float:
        return float((4.0 * np.arctan(at[0])) ** 2) if knows_misfit else 0.0

    for _ in range(count):
        previous, before = at, misfit()
        at = pacing.point(at - (1.0 + at**2) * np.arctan(at), previous)
        pacing.begin(1.0, 1, previous, before)
        pacing.end(1.0, 0, misfit())
        found.append(abs(float(at[0])))
    return found


def test_steps_longer_than_the_linearisation_holds_are_shortened_until_they_lead_there():
    assert passes(20, knows_misfit=True)[-1] < 1e-9
    whole = passes(5, knows_misfit=False)
    assert whole == sorted(whole), "whole steps diverge"


@pytest.mark.parametrize(("before", "taken_back"), [(50.0, True), (5e3, False)])
def test_no_step_from_a_point_that_is_far_off_is_taken_back(before, taken_back):
    pacing = Pacing(settled=False)
    pacing.begin(1.0, 1, np.zeros(2), before)
    pacing.end(10.0, 0, 10.0 * before)
    point = pacing.point(np.full(2, 2.0), np.ones(2))
    assert np.array_equal(point, np.full(2, 2.0)) != taken_back


@pytest.mark.parametrize(("before", "after"), [(50.0, 50.1), (50.0, 3.0), (1.0, 1.9)])
def test_a_misfit_that_stays_falls_or_is_of_noise_shortens_no_step(before, after):
    pacing = Pacing(settled=False)
    pacing.begin(1.0, 1, np.zeros(2), before)
    pacing.end(0.01, 0, after)
    assert pacing.settled
    np.testing.assert_array_equal(pacing.point(np.ones(2), np.zeros(2)), np.ones(2))
