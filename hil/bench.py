"""One run: truth, devices and daemon put together, in virtual or real time, and judged.

The daemon is the flight software's own `fsw.app.build`; in real time it is `fsw run` in a process of
its own. What is scored comes from its estimates, or from its recording.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fsw.config import Config, load
from fsw.daemon import Ports, build
from fsw.drivers.sources import ImuSource
from fsw.drivers.wire import ByteChunk
from fsw.estimators.online import build_online
from fsw.messages import Block, BodyEstimate, Estimate, Event, ImuSample
from fsw.recorder import RecorderSink, open_recording
from fsw.replay import replay
from fsw.sinks import Fanout, NullSink, Sink
from fsw.status import estimate_summary
from hil import live
from hil.bound import sensitivity
from hil.endeffector import Verification
from hil.flight import (
    BUS,
    bound_sensors,
    flight_document,
    plant_document,
    write_flight,
    write_yaml,
)
from hil.floating import FloatingRobot
from hil.history import TruthHistory
from hil.inertia import FloatArray, pi_of
from hil.links import VirtualBench
from hil.plant import Plant
from hil.progress import Meter
from hil.report import Point, Residuals, Story
from hil.robot import Body, Robot
from hil.scenario import Prior, Scenario, draw_prior
from hil.score import (
    BOUND_RATE_HZ,
    Case,
    Result,
    bound_sigmas,
    comparison,
    result_from,
    rows,
    score,
)
from hil.sensors import SensorConfig
from hil.spline import JointSpline
from hil.truth import simulate

T0_NS = 10_000_000_000  # virtual time of power-on
EDGE_S = 0.1  # truth simulated at rest before and after the motion
METER_PERIOD_S = 0.2
VALIDITY_FROM_S = 5.0  # the IMU's clock model has settled


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setup:
    """Everything about a run that is fixed before it starts."""

    scenario: Scenario
    seed: int
    folder: Path
    config_path: Path
    config: Config
    priors: dict[str, Prior]
    robot: Robot
    spline: JointSpline
    history: TruthHistory
    bus_port: int

    @property
    def total_s(self) -> float:
        """Length of the run from the first SYNC."""
        return self.scenario.before_s + self.spline.duration_s + self.scenario.after_s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recorded:
    """What a run left behind."""

    estimates: Sequence[Estimate]
    blocks: Sequence[Block]
    imu_chunks: Sequence[ByteChunk]
    events: Sequence[Event]
    final: Result
    method: str
    status: Mapping[str, Any]
    origin_ns: int  # start of the motion on the daemon's clock
    imu_times: Mapping[str, float]  # t0_ns and period_ns of the device's samples
    wall_s: float
    extra: Mapping[str, Any] = field(default_factory=dict)


class Collector(NullSink):
    """Keeps what the score and the picture need."""

    def __init__(self) -> None:
        self.estimates: list[Estimate] = []
        self.blocks: list[Block] = []
        self.imu_chunks: list[ByteChunk] = []
        self.events: list[Event] = []

    def serial(self, device: str, chunks: Sequence[ByteChunk]) -> None:
        """Keep the inertial unit's bytes."""
        if device == "imu":
            self.imu_chunks += chunks

    def block(self, block: Block) -> None:
        """Keep."""
        self.blocks.append(block)

    def estimate(self, estimate: Estimate) -> None:
        """Keep."""
        self.estimates.append(estimate)

    def event(self, event: Event) -> None:
        """Keep."""
        self.events.append(event)


def prepare(
    scenario: Scenario,
    seed: int,
    folder: Path,
    *,
    bus_port: int | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Setup:
    """Draw the priors, write the flight configuration, simulate the truth.

    Raises
    ------
    ScenarioError, or the flight software's ConfigError, when something does not fit.
    """
    bodies = {name: _body(report) for name, report in scenario.truth.items()}
    robot = Robot.load(
        scenario.urdf, scenario.tool_frame, bodies.get("base"), bodies.get("target")
    )
    spline = JointSpline.load(scenario.identification)
    priors = {body: draw_prior(scenario.truth[body], seed, body) for body in scenario.unknown}
    port = bus_port if bus_port is not None else int(scenario.flight["bus"]["port"])
    document = flight_document(
        scenario, priors, robot.joint_names, folder, port, overrides or {}
    )
    path = write_flight(folder, scenario, priors, document)
    history = simulate(robot, spline, -EDGE_S, spline.duration_s + EDGE_S)
    return Setup(
        scenario=scenario,
        seed=seed,
        folder=folder,
        config_path=path,
        config=load(path),
        priors=priors,
        robot=robot,
        spline=spline,
        history=history,
        bus_port=port,
    )


def run_virtual(setup: Setup, meter: Meter, *, record: bool) -> Recorded:
    """Run plant and daemon in one thread in virtual time; a seed fixes every bit."""
    sensors = SensorConfig.from_dict(setup.scenario.sensors)
    plant = Plant(
        setup.history,
        sensors,
        setup.seed,
        start_delay_s=setup.scenario.before_s,
        t0_ns=T0_NS,
    )
    bench = VirtualBench(plant, T0_NS, seed=setup.seed)
    collector = Collector()
    sink: Sink = collector
    if record:
        writer = open_recording(setup.config, setup.folder / "recording.mcap")
        sink = Fanout(collector, RecorderSink(writer, lambda _s, _c, _t: None))
    ports = Ports(can={BUS: bench.can}, imu=bench.imu, star_tracker=bench.star_tracker)
    began_s = time.perf_counter()
    daemon = build(setup.config, bench.clock, ports, sink)
    end_ns = T0_NS + round(setup.total_s * 1e9)
    shown_s = 0.0

    def ended() -> bool:
        nonlocal shown_s
        now_ns = bench.clock.now_ns()
        wall_s = time.perf_counter()
        if wall_s - shown_s > METER_PERIOD_S:
            shown_s = wall_s
            meter.update((now_ns - T0_NS) * 1e-9, estimate_summary(daemon.latest))
        return now_ns >= end_ns

    daemon.run(ended)
    final = daemon.shutdown()
    wall_s = time.perf_counter() - began_s
    status = daemon.status(bench.clock.now_ns())
    meter.update(setup.total_s, estimate_summary(final))
    times = plant.times()
    return Recorded(
        estimates=collector.estimates,
        blocks=collector.blocks,
        imu_chunks=collector.imu_chunks,
        events=collector.events,
        final=_result(final, setup.scenario.unknown),
        method=final.method if final is not None else setup.config.estimator.method,
        status=status,
        origin_ns=int(times["origin_ns"] or T0_NS),
        imu_times=times["imu"],
        wall_s=wall_s,
    )


def run_live(setup: Setup, meter: Meter) -> Recorded:
    """Run plant and daemon as processes in real time, then read the daemon's recording.

    The daemon's own last estimate is scored; a replay of its recording gives the conditioned blocks
    for the picture, and how far a replay is from the live result.
    """
    scenario = setup.scenario
    plant = plant_document(scenario, setup.seed, setup.folder, setup.bus_port)
    plant_path = write_yaml(setup.folder / "plant.yaml", plant)
    outcome = live.run(setup.config_path, plant_path, setup.total_s, meter)
    collector = Collector()
    replayed = replay(outcome.recording, setup.config, sink=collector)
    final = outcome.final
    result = _result_from_json(final, scenario.unknown)
    again = _result(replayed.estimate, scenario.unknown)
    scale = np.sqrt(np.diag(result.covariance))
    return Recorded(
        estimates=collector.estimates,
        blocks=collector.blocks,
        imu_chunks=collector.imu_chunks,
        events=collector.events,
        final=result,
        method=str(final["method"]),
        status=outcome.status,
        origin_ns=int(outcome.plant["origin_ns"]),
        imu_times=outcome.plant["imu"],
        wall_s=outcome.wall_s,
        extra={
            "recording": str(outcome.recording),
            "replay_difference_sigma": float(np.max(np.abs(again.x - result.x) / scale)),
            "recorder_dropped": replayed.dropped,
            "daemon_exit_code": outcome.exit_code,
        },
    )


def make_case(setup: Setup) -> Case:
    """Return what the run's result is judged against."""
    scenario = setup.scenario
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    robot = FloatingRobot(scenario.urdf, scenario.tool_frame, pis, scenario.unknown)
    spline = JointSpline.load(scenario.verification)
    t_s = np.arange(-scenario.before_s, setup.spline.duration_s + scenario.after_s, 1 / BOUND_RATE_HZ)
    inside = np.clip(t_s, setup.history.start_s, setup.history.end_s)
    state = setup.history.at(inside)
    return Case(
        unknown=scenario.unknown,
        truth=scenario.truth,
        priors=setup.priors,
        robot=robot,
        verification=Verification(robot, lambda t: spline.evaluate(t)[:2], spline.duration_s),
        bound_sigmas=bound_sigmas(
            robot,
            bound_sensors(scenario, robot.n),
            scenario.truth,
            setup.priors,
            (state.q, state.qd, state.qdd),
        ),
    )


def judge(setup: Setup, case: Case, recorded: Recorded) -> dict[str, Any]:
    """Return the JSON of the run."""
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
    last = recorded.estimates[-1] if recorded.estimates else None
    return outcome | {
        "samples": samples,
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
    """Return what the paper's plain least squares makes of the same blocks; None without blocks."""
    if not blocks:
        return None
    settings = setup.config.estimator.model_copy(update={"method": "mrnea", "weighting": "ols"})
    estimator = build_online(setup.config.model_copy(update={"estimator": settings}))
    for block in blocks:
        estimator.push(block)
    return _result(estimator.finish(), setup.scenario.unknown)


def time_of_validity(setup: Setup, recorded: Recorded) -> dict[str, float] | None:
    """Return rms and maximum error [s] of the IMU samples' times after the first seconds.

    The daemon's own source decodes the recorded bytes again; a sample belongs to the device's
    nearest sampling instant, which is unique as long as the error is below half a period.
    """
    source = ImuSource(setup.config.imu)
    samples = [s for s in source.feed(recorded.imu_chunks) if isinstance(s, ImuSample)]
    if not samples:
        return None
    imu = setup.config.imu
    t0_ns, period_ns = recorded.imu_times["t0_ns"], recorded.imu_times["period_ns"]
    start_ns = samples[0].t_gyro_ns + VALIDITY_FROM_S * 1e9
    estimated = np.array([s.t_gyro_ns for s in samples if s.t_gyro_ns > start_ns], dtype=float)
    instant = estimated - t0_ns + imu.gyro_group_delay_s * 1e9
    error_s = (instant - np.rint(instant / period_ns) * period_ns) * 1e-9
    if error_s.size == 0:
        return None
    return {
        "rms_s": float(np.sqrt(np.mean(error_s**2))),
        "max_s": float(np.max(np.abs(error_s))),
    }


def make_story(setup: Setup, case: Case, recorded: Recorded, outcome: Mapping[str, Any]) -> Story:
    """Return what the picture shows."""
    unknown = setup.scenario.unknown
    points = [
        Point(
            t_s=(estimate.t_ns - recorded.origin_ns) * 1e-9,
            valid=estimate.valid,
            reports={b: _report(estimate.bodies[b]) for b in unknown},
            sigmas={b: _sigma(estimate.bodies[b]) for b in unknown},
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


def torque_residuals(setup: Setup, case: Case, recorded: Recorded) -> Residuals:
    """Return measured less predicted torque of every block at the final estimate."""
    sensors = bound_sensors(setup.scenario, case.robot.n)
    offsets = np.zeros(case.robot.n)
    if recorded.estimates:
        last = recorded.estimates[-1]
        where = [k for k, name in enumerate(last.names) if name.startswith("torque_offset.")]
        if where:
            offsets = last.mean[where]
    times, rows_nm = [np.empty(0)], [np.empty((0, case.robot.n))]
    for block in recorded.blocks:
        times.append((block.t_ns - recorded.origin_ns) * 1e-9)
        states = zip(block.q_rad, block.qd_rad_s, block.qdd_rad_s2, strict=True)
        predicted = [
            sensitivity(case.robot, sensors, recorded.final.x, *state).tau_nm for state in states
        ]
        rows_nm.append(block.tau_nm - np.array(predicted) - offsets)
    return Residuals(t_s=np.concatenate(times), torque_nm=np.concatenate(rows_nm))


def _result(estimate: Estimate | None, unknown: Sequence[str]) -> Result:
    """Return the final result; without any estimate an invalid one that says so."""
    if estimate is None:
        size = 10 * len(unknown)
        nothing = result_from(
            unknown, np.ones(size), np.eye(size), valid=False, reason="NO_ESTIMATE"
        )
        return nothing
    result = result_from(
        unknown,
        estimate.mean,
        estimate.covariance,
        valid=estimate.valid,
        reason=estimate.reason,
    )
    return replace(
        result,
        reports={b: _report(estimate.bodies[b]) for b in unknown},
        sigmas={b: _sigma(estimate.bodies[b]) for b in unknown},
    )


def _result_from_json(values: Mapping[str, Any], unknown: Sequence[str]) -> Result:
    """Return the result of a recorded /estimate message."""
    result = result_from(
        unknown,
        np.array(values["mean"]),
        np.array(values["covariance"]),
        valid=bool(values["valid"]),
        reason=str(values["reason"]),
    )
    return replace(
        result,
        reports={b: rows(values["estimate"][b]) for b in unknown},
        sigmas={b: rows(values["sigma"][b]) for b in unknown},
    )


def _report(body: BodyEstimate) -> FloatArray:
    return np.concatenate(([body.mass_kg], body.com_m, body.inertia_kg_m2))


def _sigma(body: BodyEstimate) -> FloatArray:
    return np.concatenate(([body.mass_sigma_kg], body.com_sigma_m, body.inertia_sigma_kg_m2))


def _body(report: FloatArray) -> Body:
    mass, cx, cy, cz, xx, xy, xz, yy, yz, zz = (float(x) for x in report)
    return Body(mass, (cx, cy, cz), (xx, xy, xz, yy, yz, zz))
