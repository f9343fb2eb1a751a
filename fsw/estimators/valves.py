"""Conditioning of thrusters: conversion of their valves' states to a block's edges.

An edge is a row [thruster, time from the window's centre [s], +1 opened or -1 closed]; unused rows
are zero. Edges whose force has settled before the window are left out. A valve that has always been
open has one opening edge, placed so early that its force has settled.
"""

from collections.abc import Sequence

import numpy as np

from fsw.config import ThrusterConfig
from fsw.estimators.effects.device import Part
from fsw.messages import MOST_EDGES, ChannelWindow, FloatArray, IntArray, Window
from fsw.messages.findings import Fault, Finding

SILENT_PERIODS = 5.0  # without a report for longer, a valve's state counts as unknown
SETTLED_RISES = 40.0  # rise times after which a force has settled in double precision
MARGIN_SIGMAS = 10.0  # sigmas by which a delay may be longer than configured


def changes(edges: FloatArray, tail_s: FloatArray, start_s: float) -> bool:
    """Return whether a force changes after start_s; the channels then are no polynomials.

    `tail_s` (K,): time from a change of a valve to the settled force [s].
    """
    used = edges[edges[:, 2] != 0.0]
    return bool(np.any(used[:, 1] + tail_s[used[:, 0].astype(np.intp)] > start_s))


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
