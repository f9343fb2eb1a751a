"""Wrenches from outside that nothing declares, in MuJoCo's motion: found, told apart, left out."""

from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest

from fsw.config import Config
from fsw.estimators.recursive.online import OnlineEstimator, build_online
from fsw.messages import Block, Estimate
from hil.world.contact import Contact, Fixture
from hil.world.history import TruthHistory
from hil.world.links import Body
from hil.world.robot import Robot
from hil.world.thrusters import Jet, Pulse, ThrusterSystem
from hil.world.truth import simulate
from tests.support.estimator_cases import (
    BASE,
    TARGET,
    URDF,
    WINDOW_S,
    draw_biases,
    make_config,
    noisy,
    parameters,
    robot_model,
    true_block,
    wrong,
)
from tests.support.thruster_cases import STAR_TRACKER
from tests.support.truth_cases import pin_state, stand_in

JET = Jet(place_m=(1.5, -1.1, 0.9), direction=(0, 1, 0), force_n=22.0)
CONTACT = Contact(
    from_s=14.0,
    to_s=20.0,
    stiffness_n_m=300.0,
    damping_n_s_m=300.0,
    turn_stiffness_nm_rad=200.0,
    turn_damping_nms_rad=200.0,
)
FIRINGS = (Pulse(jet=0, on_s=14.0, for_s=0.6), Pulse(jet=0, on_s=18.0, for_s=4.0))
END_S = 28.0
CHI2_10_9999 = 35.6  # 99.99 % bound of chi-squared with 10 degrees of freedom


@lru_cache(maxsize=2)
def flight(what: str) -> TruthHistory:
    system = ThrusterSystem(jets=(JET,), pulses=FIRINGS if what == "firing" else (), rise_s=0.02)
    robot = Robot.load(URDF, "tool", base=BASE, target=TARGET, thrusters=system)
    wrench = Fixture(CONTACT) if what == "contact" else None
    return simulate(robot, stand_in("target_leo").spline, 0.0, END_S, 0.005, wrench=wrench)


def blocks(what: str, seed: int = 1) -> list[Block]:
    rng = np.random.default_rng(seed)
    biases = draw_biases(rng)
    count = int(END_S / WINDOW_S) - 1
    return [noisy(true_block(flight(what), k * WINDOW_S, k), rng, biases) for k in range(count)]


def config(target: Body, watch: str = "watch", momentum_sigma_nms: float = 0.0) -> Config:
    data = make_config(("target",), target=target).model_dump()
    data["star_tracker"] = STAR_TRACKER
    data["estimator"]["outside_wrench"] = watch
    data["estimator"]["momentum_sigma_nms"] = momentum_sigma_nms
    return Config.model_validate(data)


def estimator(seed: int = 5, momentum_sigma_nms: float = 0.0) -> OnlineEstimator:
    own = config(wrong(TARGET, np.random.default_rng(seed)), momentum_sigma_nms=momentum_sigma_nms)
    return build_online(own, robot_model())


def run(own: OnlineEstimator, seen: list[Block]) -> tuple[list[Estimate], list[tuple[str, str]]]:
    estimates, events = [], []
    for block in seen:
        estimates.append(own.push(block))
        events += [(code, text) for _, code, text in own.events()]
    return estimates, events


def nees(own: OnlineEstimator, estimate: Estimate) -> float:
    k = own.problem.body("target")
    error = estimate.mean[k] - parameters(TARGET)
    return float(error @ np.linalg.solve(estimate.covariance[k, k], error))


def judged(what: str, code: str, momentum_sigma_nms: float = 0.0) -> list[tuple[str, str]]:
    """Run a flight; the estimate must be right at the end, and valid all along from 12 s on."""
    own = estimator(momentum_sigma_nms=momentum_sigma_nms)
    seen = blocks(what)
    estimates, events = run(own, seen)
    late = [e for b, e in zip(seen, estimates, strict=True) if b.index * WINDOW_S > 12.0]
    assert all(e.valid for e in late), [e.reason for e in late]
    assert max(nees(own, e) for e in late) < CHI2_10_9999
    assert {c for c, _ in events} == {code, code + "_ENDED"}
    out = {b.index for b, e in zip(seen, estimates, strict=True) if e.extra["outside"]}
    held = [b.index * WINDOW_S for b in seen if b.index in out]
    assert all(14.0 <= t < 24.0 for t in held)
    return events


def test_firings_that_nobody_reported_are_found_and_left_out() -> None:
    events = judged("firing", "UNKNOWN_FIRING")
    assert [code for code, _ in events] == ["UNKNOWN_FIRING", "UNKNOWN_FIRING_ENDED"] * 2
    assert "up to 22 N" in events[1][1]


def test_contact_of_the_target_is_told_as_such_and_the_estimate_waits() -> None:
    events = judged("contact", "CONTACT")
    assert [code for code, _ in events] == ["CONTACT", "CONTACT_ENDED"]


@pytest.mark.parametrize(("what", "code"), [("contact", "CONTACT"), ("firing", "UNKNOWN_FIRING")])
def test_a_new_momentum_is_found_after_release(what: str, code: str) -> None:
    """It is hundreds of sigmas of the one before; from then on rates follow from it again."""
    judged(what, code, momentum_sigma_nms=0.1)
    own, seen = estimator(momentum_sigma_nms=0.1), blocks(what)
    run(own, seen)
    watch, found = own.recursion.outside, own.recursion.x[own.problem.at("momentum")]
    assert watch is not None
    assert watch.has_acted
    assert not watch.momentum_lost
    case, state = stand_in("target_leo"), flight(what).at(np.array([END_S - 1.0]))
    q, v, _ = pin_state(state, 0)
    true = pin.computeCentroidalMomentum(case.model, case.model.createData(), q, v).angular
    assert np.linalg.norm(true) > 10.0
    sigma = np.sqrt(
        np.diag(own.recursion.memory.information.covariance())[own.problem.at("momentum")]
    )
    assert np.abs(found - true).max() < 5.0 * sigma.max() < 1.0


def test_without_the_watch_a_firing_is_never_confidently_wrong() -> None:
    own = build_online(config(wrong(TARGET, np.random.default_rng(5)), "ignore"), robot_model())
    seen = blocks("firing")
    for block, estimate in zip(seen, run(own, seen)[0], strict=True):
        assert not estimate.valid or nees(own, estimate) < CHI2_10_9999, block.index


def test_a_quiet_flight_has_no_event_and_the_same_bits_as_without_the_watch() -> None:
    seen = blocks("quiet")[:45]
    own = estimator()
    estimates, events = run(own, seen)
    plain = build_online(config(wrong(TARGET, np.random.default_rng(5)), "ignore"), robot_model())
    assert events == []
    assert np.array_equal(estimates[-1].mean, run(plain, seen)[0][-1].mean)


def test_a_change_of_the_target_is_a_change_and_no_contact() -> None:
    """From 14 s on the motion is that of a target a third lighter."""
    own, seen = estimator(), blocks("quiet")[:35]
    lighter = Body(270.0, TARGET.com_m, tuple(0.7 * x for x in TARGET.inertia_kg_m2))
    robot = Robot.load(URDF, "tool", base=BASE, target=lighter)
    other = simulate(robot, stand_in("target_leo").spline, 0.0, END_S, 0.005)
    rng = np.random.default_rng(2)
    biases = draw_biases(np.random.default_rng(1))
    seen += [noisy(true_block(other, k * WINDOW_S, k), rng, biases) for k in range(35, 60)]
    codes = [code for code, _ in run(own, seen)[1]]
    assert "CHANGE_DETECTED" in codes
    assert "CONTACT" not in codes


def test_what_the_watch_knows_survives_a_restart() -> None:
    own, seen = estimator(), blocks("firing")
    run(own, seen[:50])  # in the second firing
    kept = own.snapshot()
    other = estimator()
    other.restore(kept, {block.index: block for block in own.blocks})
    assert other.recursion.outside is not None
    assert other.recursion.outside.momentum_lost
    codes = [code for code, _ in run(other, seen[50:])[1]]
    assert codes[-1] == "UNKNOWN_FIRING_ENDED"


def test_the_fixture_pushes_back_and_holds_only_in_its_time() -> None:
    """A target moved and turned off its place is pushed back along, about the same axis."""
    import mujoco

    robot = Robot.load(URDF, "tool", base=BASE, target=TARGET)
    data, own = mujoco.MjData(robot.model), Fixture(CONTACT)
    mujoco.mj_forward(robot.model, data)
    own(0.0, data)
    own(CONTACT.from_s, data)
    assert not data.xfrc_applied.any()
    data.qpos[:3] += [0.01, 0.0, 0.0]
    mujoco.mj_forward(robot.model, data)
    own(CONTACT.from_s + 1.0, data)
    force = data.xfrc_applied[-1]
    np.testing.assert_allclose(force, [-3.0, 0, 0, 0, 0, 0], atol=1e-9)
    data.xfrc_applied[:] = 0.0
    own(CONTACT.to_s, data)
    assert not data.xfrc_applied.any()
