"""Planning: what passes keeps every limit, what cannot pass says why."""

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from evidence.excitation import cases
from hil.world.limits import check
from hil.world.truth import simulate
from planner import criteria
from planner.assess import information_root
from planner.collision import build_collisions
from planner.plan import Planner
from planner.request import InfeasibleError, MotionRequest
from planner.subject import build_subject
from planner.verify import every_limit
from tests.support.excitation_cases import limits, panelled, subject
from tests.support.sliding import JOINT, sliding_config
from tests.unit.planner.test_collision import BOX, with_geometry

SHORT = MotionRequest(duration_s=20.0, iterations=25, candidates=5)

TINY = replace(SHORT, duration_s=10.0, iterations=10, candidates=2)


@lru_cache(maxsize=1)
def planned():
    planner = Planner(subject(), limits(), None, SHORT)
    return planner, planner.plan()


def test_a_success_keeps_every_limit_ten_times_denser_and_in_the_truth():
    planner, plan = planned()
    dense = every_limit(planner.subject, limits(), None, plan.trajectory, 25.0, [subject().x])
    assert dense[0].excess < 0
    spline = cases.joint_spline(plan.trajectory)
    checks = check(cases.truth("target"), simulate(cases.truth("target"), spline, 0.0, 20.0, 0.01))
    assert all(found.ok for found in checks.values())


def test_it_tells_much_more_than_a_random_feasible_motion():
    planner, plan = planned()
    rng = np.random.default_rng(5)
    randoms = [planner.criterion.value(planner.guesses.random_feasible(rng)) for _ in range(20)]
    assert np.exp(np.median(randoms) - plan.value) > 2.0


def test_the_same_request_gives_the_same_trajectory():
    again = Planner(subject(), limits(), None, SHORT).plan()
    np.testing.assert_array_equal(again.trajectory.points_rad, planned()[1].trajectory.points_rad)


@pytest.mark.parametrize("known", [1.0, 0.1], ids=["prior", "estimate"])
def test_starts_side_by_side_give_what_they_give_in_turn(known):
    several = replace(TINY, starts=2, iterations=4)
    own = replace(subject(), prior_root=subject().prior_root / known)
    found = [Planner(own, limits(), None, replace(several, jobs=jobs)).plan() for jobs in (1, 2)]
    assert found[0].starts == found[1].starts
    assert [line.endswith(", taken") for line in found[0].starts].count(True) == 1
    points = [plan.trajectory.points_rad for plan in found]
    np.testing.assert_array_equal(*points)


def test_after_an_estimate_a_random_start_still_finds_a_motion_that_tells_more():
    """The criterion alone is nearly flat there: the search would end where it begins."""
    request = replace(TINY, iterations=15)
    own = replace(subject(), prior_root=1e3 * subject().prior_root)
    plan = Planner(own, limits(), None, request).plan()
    blind = replace(own, wide_root=own.prior_root)
    value = Planner(blind, limits(), None, request).one_start(0, None)
    assert not isinstance(value, list)
    assert plan.value < value.value


def test_a_panel_is_kept_below_its_amplitude():
    own = panelled()
    free = Planner(own, limits(), None, TINY).plan()
    wide = every_limit(
        own, limits(mode_amplitude={"panel": 9.0}), None, free.trajectory, 25.0, [own.x]
    )
    swung = next(use.value for use in wide if use.kind == "mode panel")
    kept = limits(mode_amplitude={"panel": 0.5 * swung})
    use = next(u for u in Planner(own, kept, None, TINY).plan().uses if u.kind == "mode panel")
    assert 0.1 * swung < use.value < 0.5 * swung


def test_a_random_feasible_motion_touches_a_limit():
    planner, _ = planned()
    z = planner.guesses.random_feasible(np.random.default_rng(1))
    rows = planner.rows.rows(z, [planner.subject.x])
    room = min(float(np.min([r.value - r.lower, r.upper - r.value])) for r in rows)
    assert 0 <= room < 0.01


def test_progress_names_criterion_and_worst_limit():
    told = []
    Planner(subject(), limits(), None, replace(SHORT, iterations=3), told.append).plan()
    assert any("evaluation 2: sigma" in line and "worst" in line for line in told)


@pytest.mark.parametrize(
    ("changes", "kind"),
    [
        ({"tool_box_m": ((None, None), (None, None), (3.0, None))}, "tool_box_z"),
        ({"start_rad": (0.0, 0.3, 0.0, -2.09, 0.0, 0.0, 0.0)}, "tool_distance"),
        (
            {
                "torque_nm": 1.0,
                "start_rad": (0.0, 0.5, 0.0, -1.0, 0.0, 0.5, 0.0),
                "end_rad": (0.5, 0.8, 0.0, -1.0, 0.0, 0.5, 0.0),
            },
            "torque",
        ),
    ],
)
def test_an_infeasible_request_names_limit_amount_and_time(changes, kind):
    with pytest.raises(InfeasibleError, match=rf"{kind}.* beyond the bound .*, at [0-9.]+ s") as e:
        Planner(subject(), limits(**changes), None, TINY).plan()
    assert e.value.uses[0].excess > 0


def test_a_motion_that_teaches_nothing_is_no_success():
    with pytest.raises(InfeasibleError, match=r"nothing is learnt(.|\n)*torque.* beyond"):
        Planner(subject(), limits(torque_nm=1e-6), None, TINY).plan()


def test_a_start_pose_in_collision_is_named(tmp_path):
    urdf = with_geometry(tmp_path)
    own = subject()
    touching = limits(
        clearance_m=0.05,
        start_rad=(0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        tool_distance_m=0.0,
        tool_box_m=((None, None), (None, None), (None, None)),
    )
    found = build_collisions(own.model, urdf, "tool", BOX)
    with pytest.raises(InfeasibleError, match=r"start_rad breaks\n  clearance .* at 0.00 s"):
        Planner(own, touching, found, SHORT).plan()


def test_bodies_are_kept_apart_by_the_clearance(tmp_path):
    urdf = with_geometry(tmp_path)
    own = subject()
    apart = limits(clearance_m=0.1, tool_distance_m=0.0)
    found = build_collisions(own.model, urdf, "tool", BOX)
    plan = Planner(own, apart, found, replace(SHORT, duration_s=10.0, iterations=15)).plan()
    clearances = [use for use in plan.uses if use.kind.startswith("clearance")]
    assert clearances
    assert all(use.value > 0.1 for use in clearances)


def test_the_limits_hold_for_the_whole_prior_set():
    own = build_subject(cases.config("target", 1.3), spread=0.4, draws=4)
    assert len(own.draws) == 4
    plan = Planner(own, limits(), None, SHORT).plan()
    dense = every_limit(own, limits(), None, plan.trajectory, 25.0, [own.x, *own.draws])
    assert dense[0].excess < 0


def test_a_closed_trajectory_returns_and_a_given_pose_is_kept():
    start = (0.3, 0.8, -0.2, -1.0, 0.4, 0.6, 0.1)
    request = replace(SHORT, closed=True, iterations=10)
    plan = Planner(subject(), limits(start_rad=start), None, request).plan()
    q = plan.trajectory.evaluate(np.array([0.0, 20.0]))[0]
    np.testing.assert_allclose(q, [start, start], atol=1e-9)


def test_a_second_trajectory_complements_the_first(tmp_path):
    planner, plan = planned()
    own = planner.subject
    root = information_root(own, plan.trajectory, SHORT.rate_hz)
    covariance = criteria.covariance(root, len(own.x))[: len(own.x)]
    path = tmp_path / "result.json"
    names = list(own.problem.names[: len(own.x)])
    path.write_text(
        json.dumps({"names": names, "mean": own.x.tolist(), "covariance": covariance.tolist()})
    )
    later = build_subject(own.config, after=path)
    np.testing.assert_allclose(later.x, own.x)
    again = Planner(later, limits(), None, SHORT)
    z = again._from(plan.trajectory)
    second = again.plan(plan.trajectory)
    # judged by what both give together: better than flying the first one again
    assert second.value < again.criterion.value(z)


SLIDING = {"range_margin_m": 0.0, "speed_m_s": 0.05, "acceleration_m_s2": 0.02, "force_n": 15.0}


def test_a_joint_that_slides_keeps_its_limits_in_metres(tmp_path):
    own = build_subject(sliding_config(tmp_path, ("target",)))
    bounds = limits(sliding=SLIDING)
    plan = Planner(own, bounds, None, TINY).plan()
    uses = {use.kind: use for use in every_limit(own, bounds, None, plan.trajectory, 25.0, [own.x])}
    t_s = np.linspace(0.0, TINY.duration_s, 2001)
    q, qd, qdd = (part[:, JOINT] for part in plan.trajectory.evaluate(t_s)[:3])
    assert np.abs(qd).max() <= SLIDING["speed_m_s"]
    assert np.abs(qdd).max() <= SLIDING["acceleration_m_s2"]
    assert np.ptp(q) > 0.01
    assert uses["joint_speed joint4"].unit == "m/s"
    assert uses["force joint4"].unit == "N"
    assert uses["torque joint3"].unit == "N m"
    force = [
        own.kernel.motion(*(part[k] for part in plan.trajectory.evaluate(t_s)[:3]), own.x)
        for k in range(0, 2001, 40)
    ]
    assert np.abs([f.full()[JOINT, 0] for f in force]).max() <= SLIDING["force_n"]
