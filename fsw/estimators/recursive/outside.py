"""Wrenches from outside that nothing declares: unknown firings, and contact of the target.

With the measured rate, the torque and specific force of a block do not depend on momentum. If noise
does not explain them, a wrench that is free at every node is fitted: on the base, as of a jet
that nobody reported, or on the target, as of a contact. The two are distinguishable: a wrench on
the base loads joints only by the base's acceleration, which is measured. The momentum that a wrench
adds is unknown: rates are used as measured until the recursion has found a new momentum, or for
good if no momentum is estimated. A change of the bodies looks like a wrench in one block, but one
change explains several blocks and a wrench does not.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtri

from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.motion_noise import residual_covariance
from fsw.estimators.model.inertia import PARAMETERS, is_consistent
from fsw.estimators.model.problem import Problem
from fsw.estimators.recursive.snapshot import kept, put
from fsw.messages import Block, FloatArray

DECIDING_BLOCKS = 5  # blocks that one change of the bodies must explain
GOOD_BLOCKS = 2  # that fit in a row and end a wrench
ITERATIONS = 4  # of fitting a change
WRENCH = 6
CODES = {"base": "UNKNOWN_FIRING", "target": "CONTACT"}
_STATE = ("place", "momentum_lost", "has_acted", "_good", "_since_ns", "_largest")


class Verdict(Enum):
    """How the recursion must treat a block."""

    FITS = 0
    OUTSIDE = 1  # a wrench from outside acts: leave the block out
    CHANGE = 2  # the bodies have changed


@dataclass(frozen=True, slots=True, eq=False)
class _Innovation:
    """Residual (k,) of a block, its noise covariance (k, k), Jacobian (k, p'), rows per node."""

    r: FloatArray
    S: FloatArray
    J: FloatArray
    width: int


class OutsideWatch:
    """Finds wrenches from outside, block by block.

    Attributes
    ----------
    place : "base" or "target" while a wrench is known to act there; empty: none is
    momentum_lost : whether a wrench has acted since the state's momentum was found
    has_acted : whether a wrench has acted at all, so that the flight has more than one momentum
    """

    def __init__(self, problem: Problem, false_alarm: float) -> None:
        """`false_alarm`: probability that a good block does not fit."""
        p = len(problem.names)
        self._problem, self._false_alarm = problem, false_alarm
        self._ways = {"base": slice(p, p + WRENCH), "target": slice(p + WRENCH, p + 2 * WRENCH)}
        places = slice(p + WRENCH, p + 2 * WRENCH + 3)
        self._shadow = problem.placed(wrench=self._ways["base"], target_wrench=places)
        self._size = places.stop
        self.place, self.momentum_lost, self.has_acted = "", False, False
        self._suspects: list[Block] = []
        self._places: list[str] = []
        self._good, self._since_ns = 0, 0
        self._largest = np.zeros(2)  # force [N], moment [N m]
        self._events: list[tuple[str, str, str]] = []

    def copied(self) -> OutsideWatch:
        """Return a copy without the events, which stay here."""
        other = copy(self)
        other._events = []  # noqa: SLF001
        return other

    def take_events(self) -> list[tuple[str, str, str]]:
        """Return and discard severity, code and text of what happened."""
        events, self._events = self._events, []
        return events

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain values; a restart discards the blocks in question."""
        return kept(self, _STATE)

    def restore(self, values: Mapping[str, Any]) -> None:
        """Continue from a snapshot."""
        put(self, _STATE, values)

    def forget(self) -> None:
        """Discard the blocks in question at a restart; after a wrench the momentum is lost."""
        self._suspects, self._places, self.place = [], [], ""
        self.momentum_lost = self.has_acted

    @property
    def has_released(self) -> bool:
        """Return whether no wrench acts any more while the new momentum is still to be found."""
        return self.momentum_lost and not self._in_question

    def found_momentum(self) -> None:
        """Record that the state has the momentum after the last wrench."""
        self.momentum_lost = False

    def judge(
        self, block: Block, x: FloatArray, covariance_root: FloatArray, level: float
    ) -> Verdict:
        """Return the verdict on a block.

        Parameters
        ----------
        x : (p,) the estimate
        covariance_root : (p, p) of the estimate
        level : ratio of the noise variance to the declared one
        """
        undecided = Verdict.OUTSIDE if self._in_question else Verdict.FITS
        found = self._innovation(block, x, level)
        if found is None:
            return undecided
        V = found.J[:, : len(x)] @ covariance_root
        S = found.S + V @ V.T
        if found.r @ np.linalg.solve(S, found.r) <= self._limit(len(found.r)):
            return self._fits(int(block.t_ns[0]))
        place = self._explained(found, S)
        if not place:
            return undecided
        if not self._in_question:
            self._since_ns, self._largest = int(block.t_ns[0]), np.zeros(2)
        self._good, self.momentum_lost = 0, True
        self._note(found, S, place)
        if not self.place:
            self._suspects.append(block)
            self._places.append(place)
            if len(self._suspects) == DECIDING_BLOCKS:
                if self._is_change(x, level):
                    return Verdict.CHANGE
                self._begin(int(block.t_ns[-1]))
        return Verdict.OUTSIDE

    @property
    def _in_question(self) -> bool:
        return bool(self.place or self._suspects)

    def _fits(self, t_ns: int) -> Verdict:
        if not self._in_question:
            return Verdict.FITS
        self._good += 1
        if self._good < GOOD_BLOCKS:
            return Verdict.OUTSIDE
        if not self.place:
            self._begin(t_ns)
        force_n, moment_nm = self._largest.tolist()
        text = (
            f"the wrench on the {self.place} has ended after "
            f"{(t_ns - self._since_ns) * 1e-9:.1f} s (up to {force_n:.2g} N, {moment_nm:.2g} N m); "
            "the momentum is another one"
        )
        self._events.append(("info", CODES[self.place] + "_ENDED", text))
        self.place = ""
        return Verdict.FITS

    def _begin(self, t_ns: int) -> None:
        """Decide where the wrench acts and report it; discard the blocks in question."""
        self.has_acted = True
        self.place = max(CODES, key=self._places.count)
        self._suspects, self._places = [], []
        force_n, moment_nm = self._largest.tolist()
        text = (
            f"a wrench from outside on the {self.place}, begun "
            f"{(t_ns - self._since_ns) * 1e-9:.1f} s ago, up to {force_n:.2g} N and "
            f"{moment_nm:.2g} N m; the estimate waits"
        )
        self._events.append(("medium", CODES[self.place], text))

    def _limit(self, dof: int) -> float:
        return float(chdtri(dof, self._false_alarm))

    def _innovation(self, block: Block, x: FloatArray, level: float) -> _Innovation | None:
        """Return measured minus predicted torque and specific force; None if they are missing."""
        if not block.has_gyro:
            return None
        s = BlockStack((block,))
        use = np.concatenate([block.has_joint, np.full(3, block.has_accelerometer), np.zeros(3)])
        use = use.astype(np.bool_)
        if not use.any():
            return None
        at = predict(
            s, np.concatenate([x, np.zeros(self._size - len(x))]), self._shadow, "measured"
        )
        r = np.concatenate([s.tau_nm - at.tau_nm, s.f_NS_B_m_s2 - at.f_m_s2], axis=1)
        J = at.J[:, use]
        return _Innovation(
            r=r[:, use[:-3]].ravel(),
            S=level * residual_covariance(s, at, use, "measured")[0],
            J=J.reshape(-1, self._size),
            width=J.shape[1],
        )

    def _fit(self, found: _Innovation, S: FloatArray, place: str) -> tuple[float, FloatArray]:
        """Fit a wrench w (m, 6) free at every node; return the squared whitened residual, w."""
        nodes = found.J[:, self._ways[place]].reshape(-1, found.width, WRENCH)
        C = block_diag(*nodes)
        weighted = np.linalg.solve(S, np.column_stack([C, found.r]))
        w = np.linalg.lstsq(C.T @ weighted[:, :-1], C.T @ weighted[:, -1], rcond=None)[0]
        left = found.r - C @ w
        return float(left @ np.linalg.solve(S, left)), w.reshape(-1, WRENCH)

    def _explained(self, found: _Innovation, S: FloatArray) -> str:
        """Return where a wrench explains an innovation, "base" before "target"; "" if nowhere."""
        limit = self._limit(len(found.r) - WRENCH * (len(found.r) // found.width))
        left = {place: self._fit(found, S, place)[0] for place in CODES}
        return next((place for place, nis in left.items() if nis <= limit), "")

    def _note(self, found: _Innovation, S: FloatArray, place: str) -> None:
        w = self._fit(found, S, place)[1]
        sizes = [np.linalg.norm(w[:, k], axis=1).max() for k in (slice(0, 3), slice(3, 6))]
        self._largest = np.maximum(self._largest, sizes)

    def _is_change(self, x: FloatArray, level: float) -> bool:
        """Return whether one change of the bodies, within their prior, explains the suspects."""
        k = self._problem.bodies
        prior = np.linalg.solve(self._problem.prior_covariance[k, k], np.eye(k.stop))
        at, nis, dof = x.copy(), np.inf, 0
        for _ in range(ITERATIONS):
            information, rhs, nis, dof = prior.copy(), -prior @ (at - x)[k], 0.0, 0
            for block in self._suspects:
                found = self._innovation(block, at, level)
                if found is None:
                    continue
                weighted = np.linalg.solve(found.S, np.column_stack([found.J[:, k], found.r]))
                information += found.J[:, k].T @ weighted[:, :-1]
                rhs += found.J[:, k].T @ weighted[:, -1]
                nis += float(found.r @ weighted[:, -1])
                dof += len(found.r)
            at[k] += np.linalg.solve(information, rhs)
            bodies = at[k].reshape(-1, PARAMETERS)
            if not all(is_consistent(pi) for pi in bodies):  # it leads to an impossible body
                return False
        step = (at - x)[k]
        return nis + float(step @ prior @ step) <= self._limit(dof)
