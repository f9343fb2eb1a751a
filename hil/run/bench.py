"""One run of the bench: truth, devices and daemon together, in virtual or real time.

The daemon is the loop and the estimation of the flight software; in real time it is `fsw run` in a
separate process. The judgement uses the daemon's estimates or the daemon's recording.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fsw.config import Config, load
from fsw.drivers.wire import ByteChunk
from fsw.estimators.pipeline import default_pipeline
from fsw.exchange.sinks import Fanout, Sink
from fsw.exchange.status import estimate_summary
from fsw.loop.ports import SECOND, Ports
from fsw.messages import Block, Estimate, Event
from fsw.service.recorder import RecorderSink, open_recording
from hil.devices.plant import Plant
from hil.faults.script import install
from hil.judge.outcome import result_from_json, result_of
from hil.judge.score import Result
from hil.judge.stalls import bench_stalls
from hil.links.virtual import VirtualBench
from hil.run import live
from hil.run.collector import Collector
from hil.run.daemon import Daemon
from hil.run.flight import FLIGHT, flight_document, write_flight, write_yaml
from hil.run.motions import motion, motion_of
from hil.run.own_flight import exact_result, own_document, own_priors
from hil.run.plant_document import plant_document
from hil.run.progress import Meter
from hil.world.history import TruthHistory
from hil.world.links import body_of
from hil.world.prior import Prior, draw_prior
from hil.world.robot import Robot
from hil.world.scenario import Scenario, ScenarioError
from hil.world.sensor_config import SensorConfig
from hil.world.simulation import simulate_in
from hil.world.spline import Motion
from offline.replay import replay
from offline.report.collect import State, state_of

T0_NS = 10_000_000_000  # virtual time of power-on
RECORDING = "recording.mcap"  # of a run in virtual time
EDGE_S = 0.1  # truth simulated at rest before and after the motion
STEP_S = 0.004  # time step of the truth
METER_PERIOD_S = 0.2
EXACT = "exact"  # folder of the bench's own configuration beside a user's


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
    spline: Motion
    history: TruthHistory
    bus_ports: Mapping[str, int]  # UDP port of each bus that has one
    exact: Config | None = None  # beside a user's configuration: the bench's own of the same robot

    @property
    def total_s(self) -> float:
        """Length of the run from the first SYNC [s]."""
        return self.scenario.before_s + self.spline.duration_s + self.scenario.after_s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recorded:
    """Output of a run."""

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
    state: State | None  # whole state of the estimator; None: no estimate
    extra: Mapping[str, Any] = field(default_factory=dict)
    exact: Result | None = None  # of the configuration `exact` on the same data


def prepare(
    scenario: Scenario,
    seed: int,
    folder: Path,
    *,
    real_time: bool = False,
    overrides: Mapping[str, Any] | None = None,
    telemetry: Mapping[str, Any] | None = None,
    truth: Path | None = None,
    own: Config | None = None,
) -> Setup:
    """Draw the priors, write the flight configuration, simulate the truth.

    In real time the buses get unused ports, and the position noise includes the jitter of a SYNC
    time stamp times the motion's speed.

    Parameters
    ----------
    overrides : keys of the configuration's section `estimator`
    telemetry : the configuration's section `telemetry`; None: the daemon has no link
    own : the user's configuration, which flies as it is but for links and folders; None: the bench
        writes one in which arm, scales and mountings are exact
    truth : file with this scenario's truth from `hil.basilisk`; None: the truth is simulated

    Raises
    ------
    ScenarioError or ConfigError if scenario, motion, truth or configuration is invalid.
    """
    if real_time and scenario.faults:
        raise ScenarioError("faults: a scenario's own need virtual time: add --fast")
    robot = robot_of(scenario)
    spline = motion_of(scenario, robot)
    motion("verification", scenario.verification, robot)
    if own is None:
        priors = {body: draw_prior(scenario.truth[body], seed, body) for body in scenario.unknown}
    else:
        priors = own_priors(own)
    ports = scenario.bus_ports
    if real_time:
        ports = dict(zip(ports, live.free_udp_ports(len(ports)), strict=True))
    speeds = spline.evaluate(np.arange(0.0, spline.duration_s, 0.01))[1]
    fastest_rad_s = float(np.sqrt(np.mean(speeds**2, axis=0)).max())
    jitter_s = float(scenario.flight["sync_jitter_s"]) if real_time else 0.0
    exact = flight_document(
        scenario,
        priors,
        robot.joint_names,
        folder,
        ports,
        overrides or {},
        start_rad=spline.evaluate(np.zeros(1))[0][0].tolist(),
        stamp_noise_rad=jitter_s * fastest_rad_s,
        seed=seed if own is None else None,
    )
    document = exact
    if own is not None:
        document = own_document(own, scenario, folder, ports, overrides or {})
    if telemetry is not None:
        document["telemetry"] = (document.get("telemetry") or {}) | dict(telemetry)
    if own is None:
        path = write_flight(folder, scenario, priors, document)
    else:
        path = write_yaml(folder / FLIGHT, document)
    if truth is None:
        history = truth_of(scenario, robot, spline)
    else:
        history = _stored(truth, scenario, robot, spline)
    plant_of(scenario, robot, history, seed)  # refuses impossible devices
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
        bus_ports=ports,
        exact=None if own is None else load(write_flight(folder / EXACT, scenario, priors, exact)),
    )


def plant_of(scenario: Scenario, robot: Robot, history: TruthHistory, seed: int) -> Plant:
    """Return the devices of a scenario, powered on at T0_NS.

    Raises
    ------
    ValueError if the sensors cannot be as they are described.
    """
    return Plant(
        history,
        SensorConfig.from_dict(scenario.sensors),
        seed,
        start_delay_s=scenario.before_s,
        t0_ns=T0_NS,
        sync_rate_hz=float(scenario.flight["bus"]["rate_hz"]),
        thrusters=scenario.thrusters,
        sliding=robot.is_prismatic,
    )


def robot_of(scenario: Scenario) -> Robot:
    """Return the true robot with its bodies, tanks, panels, wheels and thrusters."""
    bodies = {name: body_of(report) for name, report in scenario.truth.items()}
    return Robot.load(
        scenario.urdf,
        scenario.tool_frame,
        bodies.get("base"),
        bodies.get("target"),
        scenario.slosh,
        {frame: bodies[name] for name, frame in scenario.frames.items()},
        scenario.wheels,
        scenario.thrusters,
        scenario.panels,
    )


def span_s(scenario: Scenario, spline: Motion) -> tuple[float, float]:
    """Return start and end of the truth [s], with the arm's rests if the robot moves in them."""
    before_s, after_s = EDGE_S, EDGE_S
    if not scenario.rests:
        before_s, after_s = max(EDGE_S, scenario.before_s), max(EDGE_S, scenario.after_s)
    return -before_s, spline.duration_s + after_s


def _stored(path: Path, scenario: Scenario, robot: Robot, spline: Motion) -> TruthHistory:
    """Return a stored truth. Raises ScenarioError if it is invalid, short or another scenario's."""
    try:
        history, name = TruthHistory.load(path)
    except (OSError, ValueError) as error:
        raise ScenarioError(f"{path}: {error}") from error
    start_s, end_s = span_s(scenario, spline)
    if name != scenario.name or history.q.shape[1] != robot.n:
        raise ScenarioError(f"{path}: the truth of {name}, not of {scenario.name}")
    if history.start_s > start_s + EDGE_S / 2 or history.end_s < end_s - EDGE_S / 2:
        covered = f"{history.start_s:g} to {history.end_s:g} s"
        raise ScenarioError(f"{path}: covers {covered}, not {start_s:g} to {end_s:g} s")
    return history


def truth_of(
    scenario: Scenario, robot: Robot, spline: Motion, dt_s: float = STEP_S
) -> TruthHistory:
    """Simulate the truth."""
    return simulate_in(
        scenario.environment,
        robot,
        spline,
        *span_s(scenario, spline),
        dt_s,
        stand=scenario.stand,
        w_NB_B_rad_s=scenario.start_rate_rad_s,
        contact=scenario.contact,
    )


class VirtualRun:
    """Plant and daemon in one thread in virtual time; a seed fixes every bit."""

    def __init__(self, setup: Setup, *, record: bool) -> None:
        self.setup = setup
        self._plant = plant_of(setup.scenario, setup.robot, setup.history, setup.seed)
        self.world = world = VirtualBench(self._plant, T0_NS, seed=setup.seed)
        install(setup.scenario.faults, world, setup.seed, T0_NS)
        self._collector = Collector()
        sink: Sink = self._collector
        if record or setup.exact is not None:
            writer = open_recording(setup.config, setup.folder / RECORDING)
            sink = Fanout(self._collector, RecorderSink(writer, live.end_unrecorded))
        cans = {**world.cans, world.can.bus + SECOND: world.redundant}
        ports = Ports(
            can=cans,
            imu=world.imu,
            star_tracker=world.star_tracker,
            feeds={name: world.serials[name] for name in self._plant.feeds},
            can_openers={name: port.open for name, port in cans.items()},
            line_openers={name: serial.reopen for name, serial in world.serials.items()},
        )
        self.daemon = Daemon(setup.config, world.clock, ports, sink)
        self._wall_s = 0.0
        self._shown_s = 0.0

    def advance(self, until_s: float, meter: Meter) -> None:
        """Continue until the given time after power-on [s]."""
        clock, daemon = self.world.clock, self.daemon
        end_ns = T0_NS + round(until_s * 1e9)
        began_s = time.perf_counter()

        def ended() -> bool:
            now_ns = clock.now_ns()
            wall_s = time.perf_counter()
            if wall_s - self._shown_s > METER_PERIOD_S:
                self._shown_s = wall_s
                meter.update((now_ns - T0_NS) * 1e-9, estimate_summary(daemon.latest))
            return now_ns >= end_ns

        daemon.run(ended)
        self._wall_s += time.perf_counter() - began_s

    def finish(self, meter: Meter) -> Recorded:
        """Shut the daemon down and return the output of the run."""
        setup, collector, daemon = self.setup, self._collector, self.daemon
        began_s = time.perf_counter()
        final = daemon.shutdown()
        self._wall_s += time.perf_counter() - began_s
        status = daemon.status()
        meter.update(setup.total_s, estimate_summary(final))
        times = self._plant.times()
        return Recorded(
            estimates=collector.estimates,
            blocks=collector.blocks,
            imu_chunks=collector.imu_chunks,
            events=collector.events,
            final=result_of(final, setup.scenario.unknown),
            method=final.method if final is not None else setup.config.estimator.method,
            status=status,
            origin_ns=int(times["origin_ns"] or T0_NS),
            imu_times=times["imu"],
            wall_s=self._wall_s,
            state=None if final is None else state_of(daemon.estimation.estimator),
            exact=exact_result(setup.exact, setup.folder / RECORDING, setup.scenario.unknown),
        )


def run_virtual(
    setup: Setup,
    meter: Meter,
    *,
    record: bool,
    disturb: Callable[[VirtualBench], None] | None = None,
) -> Recorded:
    """Run plant and daemon in one thread in virtual time; a seed fixes every bit.

    The scenario's own faults are installed; `disturb` may put further taps on the links before the
    run (see `hil.faults.taps`).
    """
    run = VirtualRun(setup, record=record)
    if disturb is not None:
        disturb(run.world)
    run.advance(setup.total_s, meter)
    return run.finish(meter)


def run_live(setup: Setup, meter: Meter) -> Recorded:
    """Run plant and daemon as processes in real time, then read the daemon's recording.

    The score uses the daemon's last estimate. A replay of the recording gives the blocks for the
    picture, and the difference between replay and live result.
    """
    scenario = setup.scenario
    plant = plant_document(scenario, setup.seed, setup.folder, setup.bus_ports)
    plant_path = write_yaml(setup.folder / "plant.yaml", plant)
    link = setup.config.telemetry
    disturb = live.nothing if link is None else live.Announcement(setup.folder, link)
    outcome = live.run(setup.config_path, plant_path, setup.total_s, meter, disturb)
    collector, pipeline = Collector(), default_pipeline(setup.config)
    replayed = replay(outcome.recordings[-1], setup.config, sink=collector, pipeline=pipeline)
    final = outcome.final
    result = result_from_json(final, scenario.unknown)
    again = result_of(replayed.estimate, scenario.unknown)
    events = live.events_of(outcome.recordings)
    scale = np.sqrt(np.diag(result.covariance))
    return Recorded(
        estimates=collector.estimates,
        blocks=collector.blocks,
        imu_chunks=collector.imu_chunks,
        events=events,
        final=result,
        method=str(final["method"]),
        status=outcome.status,
        origin_ns=int(outcome.plant["origin_ns"]),
        imu_times=outcome.plant["imu"],
        wall_s=outcome.wall_s,
        state=None if replayed.estimate is None else state_of(pipeline.estimator),
        exact=exact_result(setup.exact, outcome.recordings[-1], scenario.unknown),
        extra={
            "bus": scenario.flight["bus"]["interface"],
            "recording": str(outcome.recordings[-1]),
            "replay_difference_sigma": float(np.max(np.abs(again.x - result.x) / scale)),
            "recorder_dropped": replayed.dropped,
            "daemon_exit_code": outcome.exit_code,
            "bench_stalls": bench_stalls(events, outcome.plant["stalls_ns"]),
        },
    )
