"""Joint nodes: plausibility and counters of their samples."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.config import JointConfig
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.encoder_watch import (
    GAP_PERIODS,
    RATE_GAIN,
    STUCK_RATE_RATIO,
    EncoderWatch,
)
from fsw.drivers.wire import Reject
from fsw.messages import FloatArray, IntArray
from fsw.messages.findings import Fault

HISTORY_SYNCS = 1024  # SYNCs for which accepted samples are remembered
CONTESTED_S = 1.0  # two SYNCs so close with two different answers each: no answer for that long
CHAIN = 3  # consecutive samples that are consistent with one another ...
CHAIN_S = 0.1  # ... over at least this time are accepted, even if far from the last accepted one
SLACK_SIGMAS = 10.0
UNIFORM = 12.0**0.5  # step over sigma of what rounding to the step adds
PART = 128  # samples that are judged together if the whole batch is not regular
_MASK = (1 << HISTORY_SYNCS) - 1

Refused = tuple[int, Reject, Fault | None]  # place in the batch, reason, and fault if any


class JointTrack:
    """State of one joint between batches: its newest accepted sample, watch and counters."""

    def __init__(
        self, index: int, config: JointConfig, period_s: float, step_rad: float = 0.0
    ) -> None:
        """`step_rad`: resolution of the wire; 0: negligible. The encoder's own may be coarser."""
        self.index = index
        self.config = config
        self.counts = Counters()
        self.first_sync = -1  # index of the SYNC of the first accepted sample
        self._last_t_ns = 0
        self._last_rad = 0.0
        self._newest = 0
        self._seen = 0  # bit i: a sample for SYNC newest - i was accepted in time
        self._slack_rad = SLACK_SIGMAS * config.position_noise_rad
        self._slack_rad += config.speed_limit_rad_s * period_s
        step_rad = max(step_rad, UNIFORM * config.position_noise_rad)
        self._encoder = EncoderWatch(period_s, config.speed_limit_rad_s, self._slack_rad, step_rad)
        self._most_rad_s = most_rad_s(config)
        self._contested = round(CONTESTED_S / period_s)
        self._contested_until = -1  # SYNC up to which no sample is accepted
        self._two_answers = -HISTORY_SYNCS  # newest SYNC with two different answers
        self._answer = (0.0, 0.0)  # position [rad] and torque [N m] of the newest SYNC
        self._chain = 0
        self._chain_start_ns = 0
        self._doubted_t_ns = 0
        self._doubted_rad = 0.0

    @property
    def slack_rad(self) -> float:
        """Largest step between samples that is not a jump, without the joint's motion [rad]."""
        return self._slack_rad

    @property
    def newest(self) -> int:
        """Newest SYNC with an accepted sample; -1: none yet."""
        return self._newest if self.first_sync >= 0 else -1

    @property
    def state(self) -> tuple[bool, int, int, float, float]:
        """Whether nothing is doubted, newest SYNC, its time [ns], position [rad], rate [rad/s]."""
        t_ns, position_rad, rate = self._encoder.newest
        clean = self.first_sync >= 0 and self._encoder.is_steady and t_ns == self._last_t_ns
        clean &= self._newest >= self._contested_until
        return clean, self._newest, t_ns, position_rad, rate

    def follow(
        self,
        sync: int,
        t_ns: int,
        position_rad: float,
        torque_nm: float,
        rate: float,
        count: int,
        equal: int,
    ) -> None:
        """Accept a regular batch, of which only the last sample is given.

        `sync` is its SYNC; `rate`, `count` and `equal` are as in `EncoderWatch.follow`.
        """
        self._encoder.follow(t_ns, position_rad, rate, count, equal)
        self._seen = (self._seen << count | (1 << count) - 1) & _MASK
        self._newest, self._last_t_ns, self._last_rad = sync, t_ns, position_rad
        self._answer = position_rad, torque_nm
        self._chain = 0

    def settle(self, first: int, stop: int) -> None:
        """Count as lost the SYNCs first to stop - 1 that have no sample accepted in time."""
        first = max(first, self.first_sync + 1, stop - HISTORY_SYNCS)
        if self.first_sync < 0 or first >= stop:
            return
        wanted = stop - first
        back = self._newest - stop + 1  # SYNCs from the last one to the newest accepted one
        seen = self._seen >> back if back >= 0 else self._seen << -back
        self.counts.lost += wanted - (seen & (1 << wanted) - 1).bit_count()

    def judge(
        self,
        syncs: Sequence[int],
        t_ns: Sequence[int],
        positions_rad: Sequence[float],
        torques_nm: Sequence[float],
        in_time: Sequence[bool],
        is_doubled: Callable[[int], bool],
    ) -> list[Refused]:
        """Judge calibrated values in order: return which are refused and accept the others.

        A node's frames never overtake one another, so a sample of an older SYNC is refused. A NaN
        torque is not judged. A bus that repeats a frame repeats its content. Two different answers
        to one SYNC that was not sent twice (`is_doubled`), and soon to another one, come from two
        nodes of one id, so no further answer is accepted for a while.
        """
        refused: list[Refused] = []
        limit_nm = self.config.torque_limit_nm
        look = self._encoder.look
        rows = zip(syncs, t_ns, positions_rad, torques_nm, in_time, strict=True)
        for k, (sync, time_ns, position, torque, timely) in enumerate(rows):
            first = self.first_sync < 0
            if not first and sync <= self._newest:
                differs = sync == self._newest and (position, torque) != self._answer
                differs &= not (isnan(torque) and position == self._answer[0])
                again = differs and self._is_again(sync, is_doubled)
                fault = Fault.NODE_CONTESTED if again else None
                refused.append((k, Reject.SEQUENCE, fault))
                continue
            if sync <= self._contested_until:
                refused.append((k, Reject.SEQUENCE, Fault.NODE_CONTESTED))
                self._shift(sync)
                self._newest, self._answer = sync, (position, torque)
                continue
            if torque > limit_nm or torque < -limit_nm:
                refused.append((k, Reject.RANGE, Fault.TORQUE_RANGE))
                continue
            if self._most_rad_s is not None:
                if abs(position) > self._most_rad_s:
                    refused.append((k, Reject.RANGE, Fault.ENCODER_JUMP))
                    continue
                self._encoder.follow(time_ns, position, 0.0, 1, 0)
            else:
                fault = look(time_ns, position)
                if fault is not None:
                    refused.append((k, Reject.RANGE, fault))
                    continue
                reached = self._is_reachable(self._last_t_ns, self._last_rad, time_ns, position)
                if not (first or reached or self._is_believed(time_ns, position)):
                    refused.append((k, Reject.RANGE, Fault.ENCODER_JUMP))
                    continue
            if first:
                self.first_sync = self._newest = sync
            self._shift(sync)
            self._seen |= timely
            self._newest, self._answer = sync, (position, torque)
            self._last_t_ns, self._last_rad = time_ns, position
            self._chain = 0
        return refused

    def _shift(self, sync: int) -> None:
        """Make room for a sample of a newer SYNC among those remembered."""
        self._seen = (self._seen << min(sync - self._newest, HISTORY_SYNCS)) & _MASK

    def _is_again(self, sync: int, is_doubled: Callable[[int], bool]) -> bool:
        """Note a SYNC with two different answers; return whether another one was shortly before."""
        last, self._two_answers = self._two_answers, sync
        again = 0 < sync - last <= self._contested and not is_doubled(last)
        again |= sync <= self._contested_until
        if again:
            self._contested_until = sync + self._contested
        return again

    def _is_reachable(self, t0_ns: int, position0: float, t_ns: int, position: float) -> bool:
        allowed = self._slack_rad + self.config.speed_limit_rad_s * abs(t_ns - t0_ns) * 1e-9
        return abs(position - position0) <= allowed

    def _is_believed(self, t_ns: int, position_rad: float) -> bool:
        if not (
            self._chain
            and t_ns > self._doubted_t_ns
            and self._is_reachable(self._doubted_t_ns, self._doubted_rad, t_ns, position_rad)
        ):
            self._chain = 0
            self._chain_start_ns = t_ns
        self._chain += 1
        self._doubted_t_ns, self._doubted_rad = t_ns, position_rad
        return self._chain >= CHAIN and t_ns - self._chain_start_ns >= CHAIN_S * 1e9


def most_rad_s(config: JointConfig) -> float | None:
    """Return the largest plausible speed of an encoder without position; None for others."""
    if config.speed_noise_rad_s is None:
        return None
    return config.speed_limit_rad_s + SLACK_SIGMAS * config.speed_noise_rad_s


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Calibrated values of a bus's joints in a batch, sorted by joint, then in order; all (k,).

    An encoder without position has its speed [rad/s] in place of the position. A speed beyond the
    limit of the joint is out of range. Steps of a speed are not judged, because a speed may jump.
    """

    sync: IntArray  # running index of the SYNC
    t_ns: IntArray  # stamp of the SYNC
    position_rad: FloatArray
    torque_nm: FloatArray  # NaN: not judged
    in_time: NDArray[np.bool_]

    def within(self, start: int, stop: int) -> "Readings":
        """Return the rows start to stop - 1."""
        columns = (getattr(self, column.name)[start:stop] for column in fields(self))
        return Readings(*columns)


class JointTracks:
    """Tracks of all joints of a bus.

    In a regular batch a joint has a sample for every SYNC, and the rates between samples are so
    alike that no step is a jump, wherever the running mean lies between smallest and largest rate.
    A few comparisons of arrays accept such a batch; any other batch is judged sample by sample.
    """

    def __init__(
        self,
        joints: Sequence[tuple[int, JointConfig]],
        period_s: float,
        steps_rad: Sequence[float] = (),
    ) -> None:
        """`steps_rad`: resolution of every encoder; empty: all negligible."""
        self._tracks = [
            JointTrack(index, config, period_s, step_rad)
            for (index, config), step_rad in zip(
                joints, steps_rad or [0.0] * len(joints), strict=True
            )
        ]
        configs = [config for _, config in joints]
        self._torque_limit_nm = np.array([config.torque_limit_nm for config in configs])
        self._speed_limit_rad_s = np.array([config.speed_limit_rad_s for config in configs])
        self._slack_rad = np.array([track.slack_rad for track in self._tracks])
        most = [most_rad_s(config) for config in configs]
        self._speed_only = np.array([speed is not None for speed in most])
        self._most_rad_s = np.array([speed or np.inf for speed in most])
        self._gap_ns = GAP_PERIODS * period_s * 1e9
        self._twice: dict[int, set[int]] = {}  # joints that answered a SYNC twice, by the SYNC

    def __iter__(self) -> Iterator[JointTrack]:
        return iter(self._tracks)

    def __getitem__(self, place: int) -> JointTrack:
        """Return a joint by its place in the list given to the constructor."""
        return self._tracks[place]

    def judge(self, counts: Sequence[int], readings: Readings) -> list[Refused]:
        """Judge a batch: return the refused values by place in the batch and accept the others.

        Parameters
        ----------
        counts : number of readings of each joint
        """
        bounds = np.concatenate([[0], np.cumsum(counts)]).tolist()
        present = [k for k, count in enumerate(counts) if count]
        if not present:
            return []
        regular = self._accept_regular(present, [bounds[k] for k in present], readings)
        irregular = [k for k in present if k not in regular]
        for k in irregular:
            self._note_twice(k, readings.sync[bounds[k] : bounds[k + 1]])
        refused: list[Refused] = []
        for k in irregular:
            refused += self._judge_parts(k, bounds[k], bounds[k + 1], readings)
        return refused

    def _note_twice(self, k: int, syncs: IntArray) -> None:
        """Note the SYNCs that a joint has answered twice."""
        steps = np.diff(syncs, prepend=self._tracks[k].newest)
        for sync in syncs[steps == 0].tolist():
            self._twice.setdefault(sync, set()).add(k)
        while len(self._twice) > HISTORY_SYNCS:
            del self._twice[min(self._twice)]

    def _is_doubled(self, sync: int) -> bool:
        """Return whether most nodes have answered a SYNC twice: it was sent twice."""
        return len(self._twice.get(sync, ())) > max(1, len(self._tracks) // 2)

    def _judge_parts(self, k: int, start: int, stop: int, readings: Readings) -> list[Refused]:
        """Judge the readings of a joint whose batch is not regular, in parts of `PART`."""
        refused: list[Refused] = []
        for first in range(start, stop, PART):
            part = readings.within(first, min(first + PART, stop))
            if stop - start > PART and self._accept_regular([k], [0], part):
                continue
            found = self._tracks[k].judge(
                part.sync.tolist(),
                part.t_ns.tolist(),
                part.position_rad.tolist(),
                part.torque_nm.tolist(),
                part.in_time.tolist(),
                self._is_doubled,
            )
            refused += [(first + place, reason, fault) for place, reason, fault in found]
        return refused

    def _accept_regular(self, present: list[int], starts: list[int], r: Readings) -> set[int]:
        """Accept the readings of joints whose batch is regular; return these joints' places."""
        tracks = [self._tracks[k] for k in present]
        size, heads, owners = len(r.sync), np.array(starts), np.array(present)
        stops = np.append(heads[1:], size)
        counts = stops - heads
        of = np.repeat(owners, counts)
        states = [track.state for track in tracks]
        clean, newest, last_ns, last_rad, rate = (
            np.array(column) for column in zip(*states, strict=True)
        )
        dsync, dt_ns = _steps(r.sync, heads, newest), _steps(r.t_ns, heads, last_ns)
        step = _steps(r.position_rad, heads, last_rad)
        ok = (dsync == 1) & r.in_time & (dt_ns > 0) & (dt_ns <= self._gap_ns)
        dt_s = np.where(ok, dt_ns, 1e9) * 1e-9
        rates = step / dt_s
        low = np.repeat(np.minimum(np.minimum.reduceat(rates, heads), rate), counts)
        high = np.repeat(np.maximum(np.maximum.reduceat(rates, heads), rate), counts)
        speed_rad_s, slack_rad = self._speed_limit_rad_s[of], self._slack_rad[of]
        near = np.maximum(step - low * dt_s, high * dt_s - step) <= slack_rad
        near &= np.abs(step) <= slack_rad + speed_rad_s * dt_s
        slow = np.maximum(np.abs(low), np.abs(high)) < STUCK_RATE_RATIO * speed_rad_s
        near &= slow | (step != 0.0)
        ok &= np.where(self._speed_only[of], np.abs(r.position_rad) <= self._most_rad_s[of], near)
        ok &= ~(np.abs(r.torque_nm) > self._torque_limit_nm[of])
        good = np.logical_and.reduceat(ok, heads) & clean
        age = np.repeat(stops, counts) - 1 - np.arange(size)
        mean = rate * (1.0 - RATE_GAIN) ** counts
        mean += np.add.reduceat(RATE_GAIN * (1.0 - RATE_GAIN) ** age * rates, heads)
        moved = np.maximum.reduceat(np.where(step != 0.0, np.arange(size), -1), heads)
        equal = stops - 1 - np.maximum(moved, heads - 1)
        ends = stops - 1
        rows = zip(
            tracks,
            good.tolist(),
            r.sync[ends].tolist(),
            r.t_ns[ends].tolist(),
            r.position_rad[ends].tolist(),
            r.torque_nm[ends].tolist(),
            mean.tolist(),
            counts.tolist(),
            equal.tolist(),
            strict=True,
        )
        for track, is_good, *end in rows:
            if is_good:
                track.follow(*end)
        return {k for k, is_good in zip(present, good.tolist(), strict=True) if is_good}


def _steps(values: NDArray[Any], heads: NDArray[np.intp], before: NDArray[Any]) -> NDArray[Any]:
    """Return steps (k,) from value to value; at `heads` the step from the value in `before`."""
    steps = np.empty_like(values)
    np.subtract(values[1:], values[:-1], out=steps[1:])
    steps[heads] = values[heads] - before
    return steps
