"""Thrusters: what is in doubt of each, what their valves report, and their forces.

An edge is a row [thruster, time from the window's centre [s], +1 opened or -1 closed]; unused rows
are zero. Edges whose force has settled before the window are left out. A valve that has always been
open has one opening edge, placed so early that its force has settled.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from fsw.config import Config
from fsw.config.thrusters import ThrusterConfig
from fsw.estimators.effects.device import Device, Driven, Part, Samples
from fsw.estimators.effects.on_base import Costly, OnBase, is_free
from fsw.estimators.effects.switched import Switched, changes
from fsw.estimators.model.state_group import StateGroup, per_part
from fsw.messages import MOST_EDGES, ChannelWindow, FloatArray, IntArray, Window
from fsw.messages.findings import Fault, Finding

SILENT_PERIODS = 5.0  # without a report for longer, a valve's state counts as unknown
SETTLED_RISES = 40.0  # rise times after which a force has settled in double precision
MARGIN_SIGMAS = 10.0  # sigmas by which a delay may be longer than configured

FORCE = StateGroup(  # relative error of each thruster's force
    name="thrust_scale",
    effect="force of thrusters",
    unit="",
    key="thrusters[].force_sigma_ratio",
    cause="thrusters",
    prior=per_part("thrusters", "force_sigma_ratio"),
    is_calibration=True,
    shared=0.5,  # one supply pressure
    mistake="force_n of thrusters",
)
DELAY = StateGroup(  # true delay minus the configured one
    name="thrust_delay",
    effect="delay of thrusters",
    unit="s",
    key="thrusters[].delay_sigma_s",
    cause="thrusters",
    prior=per_part("thrusters", "delay_sigma_s"),
    is_calibration=True,
    mistake="delay_s of thrusters",
)
RISE = StateGroup(  # true rise time minus the configured one
    name="thrust_rise",
    effect="rise of thrusters",
    unit="s",
    key="thrusters[].rise_sigma_s",
    cause="thrusters",
    prior=per_part("thrusters", "rise_sigma_s"),
    is_calibration=True,
    mistake="rise_s of thrusters",
)


def _opening(_own: ThrusterConfig, t_s: FloatArray, _window_s: float) -> FloatArray:
    """Return the reports of a valve that opens after its first one."""
    is_open = (t_s > t_s[0]).astype(np.float64)
    return np.stack([is_open, np.diff(is_open, prepend=0.0)], axis=1)


def _fired(
    own: ThrusterConfig, _i: int, t_ns: IntArray, span_ns: tuple[int, int], driven: Driven
) -> Samples:
    """Return a valve's periodic reports and its changes, each change at its exact time."""
    edges = [
        (round(time_s * 1e9), state)
        for on_s, for_s in driven.firings.get(own.name, ())
        for time_s, state in ((on_s, 1.0), (on_s + for_s, 0.0))
    ]
    own_changes = [edge for edge in edges if span_ns[0] <= edge[0] < span_ns[1]]
    before = [(int(t), max((e for e in edges if e[0] < t), default=(0, 0.0))[1], 0.0) for t in t_ns]
    rows = sorted([*before, *((t, state, 1.0) for t, state in own_changes)], key=lambda row: row[0])
    return np.array([r[0] for r in rows]), np.array([r[1:] for r in rows])


def switched(config: Config, places: Mapping[str, slice]) -> Switched:
    """Return the thrusters of a configuration, for a state whose groups are at `places`."""
    own = config.thrusters
    force = np.array([t.force_n * np.array(t.direction_B) for t in own]).reshape(-1, 3)
    place = np.array([t.p_B_m for t in own]).reshape(-1, 3)
    ways = np.concatenate([force, np.cross(place, force)], axis=1).T
    times = np.array([(t.delay_s, t.rise_s) for t in own]).reshape(-1, 2)
    states = (places.get(group.name) for group in (FORCE, DELAY, RISE))
    return Switched(ways, times[:, 0], times[:, 1], config.estimator.window_s, *states)


class Valves:
    """Newest states and unsettled changes of all valves, as `Follower`."""

    def __init__(self, thrusters: Sequence[ThrusterConfig], tail_s: FloatArray) -> None:
        count, self._tail_s, self._is_first = len(thrusters), tail_s, True
        self._silent_ns = [round(SILENT_PERIODS / t.rate_hz * 1e9) for t in thrusters]
        self._settled_s = np.array(
            [
                t.delay_s
                + MARGIN_SIGMAS * t.delay_sigma_s
                + SETTLED_RISES * (t.rise_s + t.rise_sigma_s)
                for t in thrusters
            ]
        )
        self._open: list[float | None] = [None] * count  # None: not known
        self._newest_ns: list[int | None] = [None] * count
        self._edges: list[tuple[int, int, float]] = []  # thruster, time, sign; not settled yet
        self._opened_s = np.zeros(count)  # up to `_until_ns`
        self._until_ns: int | None = None

    def at(self, window: Window, _t_ns: IntArray) -> Part:
        """Return the valves' part of a block; its fields are None if a state is unknown."""
        start_ns, stop_ns = window.start_ns, window.stop_ns
        fields, missed = self.found(window.of("thrusters"), start_ns, stop_ns)
        half_s = (stop_ns - start_ns) * 0.5e-9
        text = "a change was missed; the momentum is not used any more"
        resumed, self._is_first = self._is_first and window.index > 0, False
        return Part(
            fields=fields,
            findings=[Finding(stop_ns, Fault.THRUSTER_UNKNOWN, "valves", text)] * missed,
            is_smooth=fields is None or not changes(fields["edges"], self._tail_s, -half_s),
            loses_momentum=missed or resumed,  # resumed: a change may have been missed
        )

    def found(
        self, channels: Sequence[ChannelWindow], start_ns: int, stop_ns: int
    ) -> tuple[dict[str, FloatArray] | None, bool]:
        """Return a block's columns `edges` and `opened_s`, and whether a change was missed.

        The columns are None if a valve's state is unknown during a part of the window, or if there
        are more than MOST_EDGES edges.
        """
        opened_s, missed, usable = self._counted_to(start_ns), False, True
        for k, channel in enumerate(channels):
            for t_ns, (is_open, is_change) in zip(
                channel.t_ns.tolist(), channel.values.tolist(), strict=True
            ):
                before = self._open[k]
                if np.isnan(is_open) or (
                    before is not None and is_open != before and not is_change
                ):
                    missed = missed or before is not None
                    usable = False
                    self._open[k] = None if np.isnan(is_open) else is_open
                    self._edges = [edge for edge in self._edges if edge[0] != k]
                elif before is not None and is_open != before:
                    self._edges.append((k, t_ns, 1.0 if is_open else -1.0))
                    self._open[k] = is_open
                else:  # no change; a first report holds for SILENT_PERIODS before it too
                    heard = self._newest_ns[k] is not None
                    fresh = not heard and t_ns - start_ns <= self._silent_ns[k]
                    usable = usable and (before is not None or fresh)
                    self._open[k] = is_open
                self._newest_ns[k] = t_ns
            newest_ns = self._newest_ns[k]
            silent = newest_ns is None or stop_ns - newest_ns > self._silent_ns[k]
            usable = usable and not silent
        if not usable:
            return None, missed
        centre_ns = (start_ns + stop_ns) // 2
        rows = self._rows(start_ns, centre_ns)
        if len(rows) > MOST_EDGES:
            return None, True
        edges = np.zeros((MOST_EDGES, 3))
        edges[: len(rows)] = np.array(rows).reshape(-1, 3)
        return {"edges": edges, "opened_s": opened_s}, missed

    def _counted_to(self, start_ns: int) -> FloatArray:
        """Return for how long every valve has been open (K,) up to a window's start [s]."""
        if self._until_ns is not None:
            span_s = (start_ns - self._until_ns) * 1e-9
            for k, state in enumerate(self._open):
                self._opened_s[k] += span_s * (state or 0.0)
            for k, t_ns, sign in self._edges:  # changes since that time
                if t_ns >= self._until_ns:
                    self._opened_s[k] -= sign * (t_ns - self._until_ns) * 1e-9
        self._until_ns = start_ns
        return self._opened_s.copy()

    def _rows(self, start_ns: int, centre_ns: int) -> list[tuple[float, float, float]]:
        """Return the edges that still affect a window; discard those that do not."""
        rows, kept = [], []
        level = {k: state or 0.0 for k, state in enumerate(self._open)}
        for k, t_ns, sign in self._edges:
            if (start_ns - t_ns) * 1e-9 > self._settled_s[k]:
                continue
            level[k] -= sign  # state before the first kept edge
            kept.append((k, t_ns, sign))
            rows.append((float(k), (t_ns - centre_ns) * 1e-9, sign))
        self._edges = kept
        before_s = (start_ns - centre_ns) * 1e-9
        return rows + [
            (float(k), before_s - float(self._settled_s[k]), 1.0) for k, on in level.items() if on
        ]


def _follow(config: Config) -> Valves:
    return Valves(config.thrusters, switched(config, {}).tail_s)


THRUSTERS = Device(
    section="thrusters",
    groups=(FORCE, DELAY, RISE),
    gentle=_opening,
    along=_fired,
    follow=_follow,
)


def _words(config: Config) -> list[str]:
    """Return a line for each thruster, and a line on what the model contains."""
    lines = []
    for own in config.thrusters:
        place, way = (" ".join(f"{x:.4g}" for x in v) for v in (own.p_B_m, own.direction_B))
        lines.append(
            f"{own.name}: {own.force_n:.4g} N +- {own.force_sigma_ratio:.1%} at [{place}] m along "
            f"[{way}], delay {1e3 * own.delay_s:.3g} +- {1e3 * own.delay_sigma_s:.3g} ms, rise "
            f"{1e3 * own.rise_s:.3g} +- {1e3 * own.rise_sigma_s:.3g} ms"
        )
    return [*lines, "modelled: force, delay and rise of each; propellant that leaves is not"]


def _left_out(config: Config, fired_s: float) -> list[Costly]:
    strongest_n = max((own.force_n for own in config.thrusters), default=0.0)
    words = f"thrusters, up to {strongest_n:.3g} N, {fired_s:.3g} s of firings"
    return [((), words)] * bool(config.thrusters and fired_s)


def _unplanned(fires: bool) -> str:
    if fires:
        return "thrusters: limits of the base do not count what the firings move"
    return "thrusters: counted without a firing; name them in `firings`"


ON_BASE = OnBase(
    section="thrusters",
    absent="thrusters",
    is_possible=is_free,
    words=_words,
    left_out=_left_out,
    unplanned=_unplanned,
)
