"""Recorded samples and a configuration, both of which can be changed, and how well they fit.

A change acts on the samples as a source delivers them, before they are cut into windows, or on the
configuration. Windows, blocks and problem are made again, so that every change has the effect that
it would have in flight. Only some places of a recording are kept, each with what is before it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import tau

import numpy as np

from fsw.config import Config, JointConfig
from fsw.errors import NUMERICAL
from fsw.estimators.batch.solver import Target, minimise
from fsw.estimators.conditioning.blocks import Conditioner
from fsw.estimators.measurement.row_functions import Linearisation, row_function
from fsw.estimators.model.building import build_problem, joint_order
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.robot import RobotModel
from fsw.messages import Block, ChannelWindow, FloatArray, IntArray, Window

PLACES = 8  # windows used, spread over the moving part of the recording
LEADS = 8  # most windows before each place; they give it its attitude
SPARE_S = 1.5  # samples kept on both sides of a place, so that stamps can be shifted
ITERATIONS = 12
MOST = 150  # most windows of a recording whose windows depend on all windows before
WRAP_RAD = 0.3  # a step within this of a whole turn is a wrap
GAP = 10.0  # median steps between samples, beyond which some are missing
GYRO, ACCELEROMETER, ATTITUDE = "gyro", "accelerometer", "attitude"


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """Samples of one channel in order of time; values (k, width) as in `Window`."""

    t_ns: IntArray
    values: FloatArray

    def within(self, start_ns: int, stop_ns: int, least: int = 1) -> ChannelWindow:
        """Return the samples in [start_ns, stop_ns); fewer than `least` are marked as missing."""
        k = slice(*np.searchsorted(self.t_ns, [start_ns, stop_ns]).tolist())
        few = k.stop - k.start < least
        return ChannelWindow(t_ns=self.t_ns[k], values=self.values[k], missing=few, stale=few)

    def shifted(self, by_s: float) -> Stream:
        """Return the samples with `by_s` added to their stamps."""
        return Stream(self.t_ns + round(1e9 * by_s), self.values)

    def speed(self) -> float:
        """Return the mean speed of a joint from sample to sample; 0: there are too few."""
        steps, dt_s = np.abs(np.diff(self.values[:, 0])), np.diff(self.t_ns) * 1e-9
        return float(steps.sum() / dt_s.sum()) if dt_s.size else 0.0

    def turns(self, joint: JointConfig) -> IntArray:
        """Return the whole turns (k,) by which a joint's angle has wrapped since the first sample.

        A step of about a turn is a wrap if the joint cannot make it in the time, and the steps
        before and after it are small. Over missing samples any step may be motion.
        """
        angles, dt_s = self.values[:, 0], np.diff(self.t_ns) * 1e-9
        if joint.kind != "revolute" or joint.speed_only or len(angles) < 2:
            return np.zeros(len(angles), np.int64)
        step = np.diff(angles)
        wraps = np.rint(step / tau)
        reach = np.minimum(WRAP_RAD + joint.speed_limit_rad_s * dt_s, 0.25 * tau)
        is_gap = dt_s > GAP * np.median(dt_s)
        is_step = np.abs(step) > reach
        beside = np.append(is_step[1:], False) | np.append(False, is_step[:-1])
        wraps[(np.abs(step - tau * wraps) > reach) | beside | is_gap] = 0.0
        return np.concatenate([[0], np.cumsum(wraps)]).astype(np.int64)

    def at(self, t_ns: IntArray) -> FloatArray:
        """Return the values at other times, interpolated."""
        if np.array_equal(self.t_ns, t_ns):
            return self.values
        columns = [np.interp(t_ns, self.t_ns, column) for column in self.values.T]
        return np.column_stack(columns)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """The best fit of a problem to blocks."""

    level: float  # ratio of squared residuals to declared noise; inf: no fit
    rows: int
    mean: FloatArray  # (p,) the state
    has_settled: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """Samples at some places of a recording, and a configuration to read them by.

    Attributes
    ----------
    streams : by channel: `gyro`, `accelerometer`, `attitude`, and a joint or other device by its
        section and place, such as `joints.0`
    runs : (start, stop) of consecutive windows [ns]
    centres_ns : a block is used if its window covers one of these times
    """

    config: Config
    model: RobotModel
    streams: Mapping[str, Stream]
    runs: Sequence[tuple[int, int]]
    centres_ns: IntArray

    @cached_property
    def problem(self) -> Problem:
        """The estimation problem of the configuration."""
        return build_problem(self.config, self.model)

    @cached_property
    def blocks(self) -> list[Block]:
        """The blocks of the configuration at the chosen places."""
        windows = [w for run in self.runs for w in self._windows(*run)]
        chosen = np.array(
            [
                np.any((self.centres_ns >= w.start_ns) & (self.centres_ns < w.stop_ns))
                for w in windows
            ]
        )
        conditioner = Conditioner(self.config, joint_order(self.config, self.model))
        made = conditioner.blocks(windows)
        return [
            block for block, used in zip(made, chosen, strict=True) if used and block is not None
        ]

    def _windows(self, start_ns: int, stop_ns: int) -> list[Window]:
        """Return the windows of a run; the last one ends where the run does."""
        config = self.config
        window_s, fill = config.estimator.window_s, config.estimator.min_fill_ratio
        width_ns = round(1e9 * window_s)
        rates_hz = {bus.name: bus.rate_hz for bus in config.buses}
        buses = [joint.bus for joint in config.joints]
        count = max(1, (stop_ns - start_ns) // width_ns)

        def least(rate_hz: float) -> int:
            return max(1, int(fill * rate_hz * window_s))

        inertial = least(config.imu.rate_hz)
        starts_ns = (stop_ns - width_ns * np.arange(count, 0, -1)).tolist()
        return [
            Window(
                index=at_ns // width_ns,
                start_ns=at_ns,
                stop_ns=at_ns + width_ns,
                joints=tuple(
                    self.streams[f"joints.{k}"].within(
                        at_ns, at_ns + width_ns, least(rates_hz[bus])
                    )
                    for k, bus in enumerate(buses)
                ),
                gyro=self.streams[GYRO].within(at_ns, at_ns + width_ns, inertial),
                accelerometer=self.streams[ACCELEROMETER].within(at_ns, at_ns + width_ns, inertial),
                attitude=self.streams[ATTITUDE].within(at_ns, at_ns + width_ns),
                devices={
                    section: tuple(
                        self.streams[f"{section}.{k}"].within(at_ns, at_ns + width_ns)
                        for k in range(len(own))
                    )
                    for section, own in config.devices.items()
                },
            )
            for at_ns in starts_ns
        ]

    def fit(self, iterations: int = ITERATIONS, *, plain: bool = False) -> Fit:
        """Return the best fit of the bodies; `plain` as `minimise` has it."""
        return fitted(self.problem, self.blocks, iterations, plain=plain)

    def thinned(self, places: int) -> Trial:
        """Return the trial at fewer places: the first ones if there is only one run."""
        if len(self.runs) < len(self.centres_ns):
            first, stop_ns = self.centres_ns[:places], self.runs[0][1]
            stop_ns += int(first[-1] - self.centres_ns[-1])
            return replace(self, centres_ns=first, runs=[(self.runs[0][0], stop_ns)])
        k = np.linspace(0, len(self.runs) - 1, min(places, len(self.runs))).round().astype(int)
        return replace(self, centres_ns=self.centres_ns[k], runs=[self.runs[i] for i in k])

    def configured(self, **sections: object) -> Trial:
        """Return the trial with other sections of the configuration, which are not validated."""
        return replace(self, config=self.config.model_copy(update=sections))

    def sampled(self, streams: Mapping[str, Stream]) -> Trial:
        """Return the trial with other samples of some channels."""
        return replace(self, streams={**self.streams, **streams})

    def shifted(self, channels: Sequence[str], by_s: float) -> Trial:
        """Return the trial with `by_s` added to the stamps of channels."""
        return self.sampled({name: self.streams[name].shifted(by_s) for name in channels})

    def turned(self, channels: Sequence[str], M: FloatArray) -> Trial:
        """Return the trial with the readings of channels, in S, multiplied by M (k, k)."""
        own = {name: self.streams[name] for name in channels}
        return self.sampled({k: Stream(s.t_ns, s.values @ M.T) for k, s in own.items()})

    def reread(
        self,
        position: FloatArray | float = 1.0,
        torque: FloatArray | float = 1.0,
        positions_of: Sequence[int] | None = None,
        torques_of: Sequence[int] | None = None,
    ) -> Trial:
        """Return the trial with other readings of the n joints.

        Parameters
        ----------
        position, torque : factors on the readings, all or (n,)
        positions_of, torques_of : (n,) the joint whose readings each joint gets; None: its own
        """
        joints = self.config.joints
        n = len(joints)
        factors = [np.broadcast_to(np.asarray(own, float), n) for own in (position, torque)]
        # a reading is (value + zero) / by; see `Calibration.apply`
        units = [joint.sign * (1.0 if joint.kind == "revolute" else 1.0 / tau) for joint in joints]
        by = np.array([units, [joint.sign * joint.torque_gain for joint in joints]])
        zero = np.array([[j.zero_offset_rad for j in joints], [j.torque_offset_nm for j in joints]])
        read: dict[str, Stream] = {}
        for k in range(n):
            sources = (positions_of or range(n))[k], (torques_of or range(n))[k]
            t_ns = self.streams[f"joints.{sources[0]}"].t_ns
            columns = []
            for part, source in enumerate(sources):
                value = self.streams[f"joints.{source}"].at(t_ns)[:, part]
                reading = (value + zero[part, source]) / by[part, source]
                columns.append(by[part, k] * factors[part][k] * reading - zero[part, k])
            read[f"joints.{k}"] = Stream(t_ns, np.column_stack(columns))
        return self.sampled(read)


def make_trial(
    config: Config, model: RobotModel, windows: Sequence[Window], blocks: Sequence[Block]
) -> Trial:
    """Return the trial of a recording: places where the arm moves, spread over it.

    `windows` are all windows, `blocks` those made from them.
    """
    windows = unwrapped(config, windows)
    moving = [block for block in blocks if np.abs(block.qd_rad_s).max(initial=0.0) > 0.0] or blocks
    depends = config.actuators or any(j.speed_only for j in config.joints)
    by_index = {window.index: k for k, window in enumerate(windows)}
    places = [by_index[block.index] for block in moving]
    if depends:
        places = [k for k in places if k < MOST] or places[:1]
    chosen = np.linspace(0, len(places) - 1, min(PLACES, len(places))).round().astype(int)
    places = [places[k] for k in chosen]
    heads = [0] if depends else [_head(windows, k) for k in places]
    tails = places[-1:] if depends else places
    runs = [(windows[a].start_ns, windows[b].stop_ns) for a, b in zip(heads, tails, strict=True)]
    centres = [(windows[k].start_ns + windows[k].stop_ns) // 2 for k in places]
    kept = _kept(windows, runs)
    return Trial(
        config=config,
        model=model,
        streams={
            **{
                f"joints.{k}": joined([w.joints[k] for w in kept])
                for k in range(len(config.joints))
            },
            **{
                f"{section}.{k}": joined([w.devices[section][k] for w in kept])
                for section, own in config.devices.items()
                for k in range(len(own))
            },
            GYRO: joined([w.gyro for w in kept]),
            ACCELEROMETER: joined([w.accelerometer for w in kept]),
            ATTITUDE: joined([w.attitude for w in kept]),
        },
        runs=runs,
        centres_ns=np.array(centres, np.int64),
    )


def _head(windows: Sequence[Window], place: int) -> int:
    """Return the nearest window up to `place` that has an attitude, at most LEADS before it."""
    for k in range(place, max(-1, place - LEADS - 1), -1):
        if windows[place].index - windows[k].index > place - k:  # windows between them are missing
            break
        if len(windows[k].attitude.t_ns):
            return k
    return place


def _kept(windows: Sequence[Window], runs: Sequence[tuple[int, int]]) -> list[Window]:
    spare_ns = round(1e9 * SPARE_S)
    return [
        window
        for window in windows
        if any(a - spare_ns < window.stop_ns and window.start_ns < b + spare_ns for a, b in runs)
    ]


def joined(channels: Sequence[ChannelWindow]) -> Stream:
    """Return the samples of consecutive windows of a channel as one stream."""
    t_ns = np.concatenate([channel.t_ns for channel in channels])
    return Stream(t_ns, np.concatenate([channel.values for channel in channels]))


def unwrapped(config: Config, windows: Sequence[Window]) -> Sequence[Window]:
    """Return the windows with angles of joints that do not wrap."""
    columns = []
    for k, joint in enumerate(config.joints):
        channels = [window.joints[k] for window in windows]
        turns = joined(channels).turns(joint)
        if turns.any():
            parts = np.split(turns, np.cumsum([len(own.t_ns) for own in channels])[:-1])
            channels = [
                replace(own, values=own.values - tau * np.outer(part, [1.0, 0.0]))
                for own, part in zip(channels, parts, strict=True)
            ]
        columns.append(channels)
    if not columns:
        return windows
    rows = zip(windows, zip(*columns, strict=True), strict=True)
    return [replace(window, joints=joints) for window, joints in rows]


def fitted(
    problem: Problem,
    blocks: Sequence[Block],
    iterations: int = ITERATIONS,
    *,
    plain: bool = False,
) -> Fit:
    """Return the best fit of the bodies to blocks; `plain` as `minimise` has it."""
    nothing = Fit(level=float("inf"), rows=1, mean=problem.prior_mean)
    if not blocks:
        return nothing
    linear = Linearisation(row_function("fused", "eiv", problem), blocks)
    try:
        with np.errstate(all="ignore"):
            solution = minimise(problem, Target(linear), max_iterations=iterations, plain=plain)
            rows = max(1, sum(len(own.b) for own in linear(solution.mean)))
    except NUMERICAL:
        return nothing
    fit = Fit(
        level=solution.cost / rows,
        rows=rows,
        mean=solution.mean,
        has_settled=solution.status != "NOT_CONVERGED",
    )
    return fit if np.isfinite(fit.level) else nothing
