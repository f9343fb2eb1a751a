"""Judgement of a run: the case, the JSON result, and the data of the picture."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fsw.drivers.sources import ImuSource
from fsw.estimators.recursive.online import build_online
from fsw.messages import Block
from hil.judge.applied import applied_in, doubts_of
from hil.judge.bound import sensitivity
from hil.judge.endeffector import Verification
from hil.judge.floating import FloatingRobot
from hil.judge.outcome import body_report, body_sigma, outputs, result_of
from hil.judge.report import Point, Residuals, Story
from hil.judge.score import BOUND_RATE_HZ, Case, Result, both_bounds, comparison, score
from hil.run.bench import Recorded, Setup
from hil.run.flight_sensors import bound_encoders, bound_sensors
from hil.world.inertia import FloatArray, pi_of
from hil.world.spline import JointSpline
from offline.replay_result import ReplayResult
from offline.report.build import sections_of
from offline.report.collect import collected_of
from offline.report.view import Section

VALIDITY_FROM_S = 5.0  # the IMU's clock model has converged by then
CHUNKS = 4096  # of the inertial unit that are decoded together


def make_case(setup: Setup) -> Case:
    """Return the truth and bounds that judge the result of a run."""
    scenario = setup.scenario
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    robot = FloatingRobot(
        scenario.urdf, scenario.tool_frame, pis, scenario.unknown, scenario.frames, scenario.stand
    )
    spline = JointSpline.load(scenario.verification)
    end_s = setup.spline.duration_s + scenario.after_s
    t_s = np.arange(-scenario.before_s, end_s, 1 / BOUND_RATE_HZ)
    inside = np.clip(t_s, setup.history.start_s, setup.history.end_s)
    state = setup.history.at(inside)
    known, shown = both_bounds(
        robot,
        bound_sensors(scenario, robot.n),
        bound_encoders(scenario, setup.robot.is_prismatic),
        scenario.truth,
        setup.priors,
        state,
        doubts_of(scenario.wheels, scenario.thrusters, setup.history, state),
    )
    return Case(
        unknown=scenario.unknown,
        truth=scenario.truth,
        priors=setup.priors,
        robot=robot,
        verification=Verification(robot, lambda t: spline.evaluate(t)[:2], spline.duration_s),
        bound_sigmas=known,
        true_bound_sigmas=shown,
    )


def judge(setup: Setup, case: Case, recorded: Recorded) -> dict[str, Any]:
    """Return the JSON result of the run."""
    scenario = setup.scenario
    words = ("received", "lost", "late", "rejected")
    samples = {
        source: {word: counters[word] for word in words}
        for source, counters in recorded.status["samples"].items()
    }
    outcome: dict[str, Any] = {
        "scenario": scenario.name,
        "seed": setup.seed,
        "unknown": list(scenario.unknown),
        "method": recorded.method,
    }
    outcome |= score(case, recorded.final)
    other = raw_ols(setup, recorded.blocks)
    outcome["ols"] = None if other is None else comparison(case, other)
    if recorded.exact is not None:
        exact = {"valid": recorded.exact.valid, "reason": recorded.exact.reason}
        outcome |= {"exact": comparison(case, recorded.exact) | exact}
    last = recorded.estimates[-1] if recorded.estimates else None
    return outcome | {
        "outputs": outputs(recorded.estimates, scenario.truth),
        "samples": samples,
        "events": dict(Counter(e.code for e in recorded.events if e.severity != "info")),
        "slips": recorded.status["slips"],
        "windows": recorded.status["windows"],
        "blocks": len(recorded.blocks),
        "gated": last.gated if last is not None else 0,
        "information_gained_nats": last.information_gained_nats if last is not None else 0.0,
        "condition_number": last.condition_number if last is not None else None,
        "imu_time_of_validity": time_of_validity(setup, recorded),
        "wall_s": recorded.wall_s,
        "simulated_s": setup.total_s,
        **recorded.extra,
    }


def raw_ols(setup: Setup, blocks: Sequence[Block]) -> Result | None:
    """Return the paper's OLS result on the same blocks; None without blocks or on a stand."""
    if not blocks or setup.scenario.stand is not None:
        return None
    settings = setup.config.estimator.model_copy(update={"method": "mrnea", "weighting": "ols"})
    estimator = build_online(setup.config.model_copy(update={"estimator": settings}))
    for block in blocks:
        estimator.push(block)
    return result_of(estimator.finish(), setup.scenario.unknown)


def time_of_validity(setup: Setup, recorded: Recorded) -> dict[str, float] | None:
    """Return rms and maximum error [s] of the IMU samples' times after the first seconds.

    The flight software's decoder decodes the recorded bytes again. A sample belongs to the device's
    nearest sampling instant, which is unique if the error is below half a period.
    """
    if not setup.config.imu.present:
        return None
    source, chunks = ImuSource(setup.config.imu), recorded.imu_chunks
    t0_ns, period_ns = recorded.imu_times["t0_ns"], recorded.imu_times["period_ns"]
    from_ns, count, squares, most_s = np.inf, 0, 0.0, 0.0
    for first in range(0, len(chunks), CHUNKS):
        t_gyro_ns = source.feed(chunks[first : first + CHUNKS]).t_gyro_ns
        if t_gyro_ns.size and from_ns == np.inf:
            from_ns = t_gyro_ns[0] + VALIDITY_FROM_S * 1e9
        estimated = t_gyro_ns[t_gyro_ns > from_ns].astype(float)
        instant = estimated - t0_ns + recorded.imu_times["gyro_delay_ns"]
        error_s = (instant - np.rint(instant / period_ns) * period_ns) * 1e-9
        count, squares = count + error_s.size, squares + float(error_s @ error_s)
        most_s = max(most_s, float(np.max(np.abs(error_s), initial=0.0)))
    return {"rms_s": float(np.sqrt(squares / count)), "max_s": most_s} if count else None


def make_story(setup: Setup, case: Case, recorded: Recorded, outcome: Mapping[str, Any]) -> Story:
    """Return the data of the picture."""
    unknown = setup.scenario.unknown
    points = [
        Point(
            t_s=(estimate.t_ns - recorded.origin_ns) * 1e-9,
            valid=estimate.valid,
            reports={b: body_report(estimate.bodies[b]) for b in unknown},
            sigmas={b: body_sigma(estimate.bodies[b]) for b in unknown},
            information_nats=estimate.information_gained_nats,
        )
        for estimate in recorded.estimates
    ]
    tool = case.verification
    errors = {
        "prior": tool.error(case.x_prior, case.x_truth),
        "estimate": tool.error(recorded.final.x, case.x_truth),
    }
    return Story(
        title=f"{setup.scenario.name}, seed {setup.seed}: {setup.scenario.title} "
        f"(NEES {outcome['nees']:.1f} for {outcome['dof']})",
        truth={b: setup.scenario.truth[b] for b in unknown},
        points=points,
        residuals=torque_residuals(setup, case, recorded),
        tool_errors=errors,
    )


def channel_sections(setup: Setup, recorded: Recorded) -> list[Section]:
    """Return the sections of every report: health, limits, motion, residuals, versions."""
    last = recorded.estimates[-1] if recorded.estimates else None
    state = recorded.state if recorded.blocks else None
    result = ReplayResult(
        estimate=last,
        unknown=setup.scenario.unknown,
        method=recorded.method,
        status=recorded.status,
        truncated=False,
        dropped=0,
        wall_s=recorded.wall_s,
        events=recorded.events,
        start_ns=recorded.origin_ns,
    )
    found = collected_of(setup.config, result, recorded.blocks, state)
    return sections_of(replace(found, estimates=recorded.estimates))


def torque_residuals(setup: Setup, case: Case, recorded: Recorded) -> Residuals:
    """Return measured minus predicted torque [N m] of every block at the final estimate."""
    sensors = bound_sensors(setup.scenario, case.robot.n)
    offsets = np.zeros(case.robot.n)
    if recorded.estimates:
        last = recorded.estimates[-1]
        where = [k for k, name in enumerate(last.names) if name.startswith("torque_offset.")]
        if where:
            offsets = last.mean[where]
    times: list[FloatArray] = [np.empty(0)]
    rows_nm: list[FloatArray] = [np.empty((0, case.robot.n))]
    for block in recorded.blocks:
        times.append(np.asarray((block.t_ns - recorded.origin_ns) * 1e-9, dtype=np.float64))
        states = zip(block.q_rad, block.qd_rad_s, block.qdd_rad_s2, strict=True)
        at_s = np.clip(times[-1], setup.history.start_s, setup.history.end_s)
        applied = applied_in(case.robot, case.x_truth, setup.history.at(at_s))
        predicted = [
            sensitivity(case.robot, sensors, recorded.final.x, *state, on_base).tau_nm
            for state, on_base in zip(states, applied, strict=True)
        ]
        rows_nm.append(block.tau_nm - np.array(predicted) - offsets)
    return Residuals(t_s=np.concatenate(times), torque_nm=np.concatenate(rows_nm))
