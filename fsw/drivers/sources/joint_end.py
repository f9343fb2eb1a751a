"""Readings of a bus's joints to samples: the end that all sources of joints share."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.config import JointConfig
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.joint_calibration import Calibration
from fsw.drivers.sources.joint_track import JointTracks, Readings, Refused
from fsw.messages import FloatArray, IntArray, JointSamples


class Raw(NamedTuple):
    """Values of joints in a batch; all (k,)."""

    joint: IntArray  # place in the list of joints
    number: IntArray  # running number of the sample
    t_ns: IntArray
    t_receive_ns: IntArray
    position: FloatArray  # as the device counts
    torque: FloatArray  # NaN: not usable


class Judged(NamedTuple):
    """Verdict on the readings of a batch."""

    samples: JointSamples
    counts: list[int]  # samples of each joint
    refused: list[Refused]  # by row
    silent: list[int]  # rows of samples without the torque that their joint measures


class JointEnd:
    """Calibrates and judges the values of all joints of a bus.

    Parameters
    ----------
    joints : index in the configuration and section of each joint of the bus
    period_s : nominal time between two samples of a joint
    steps_rad : resolution of every encoder [rad or m]; empty: all are negligible
    on_wire : positions are those of tailored nodes, where a revolution of a prismatic joint is a
        metre; False: they are in rad or m
    offset_ns : time of validity of a sample minus its stamp; the stamps are judged
    """

    def __init__(
        self,
        joints: Sequence[tuple[int, JointConfig]],
        period_s: float,
        steps_rad: Sequence[float] = (),
        *,
        on_wire: bool = False,
        offset_ns: int = 0,
    ) -> None:
        configs = [joint for _, joint in joints]
        self.tracks = JointTracks(joints, period_s, steps_rad)
        self.calibration = Calibration(configs, on_wire=on_wire)
        self.senses = np.array([joint.torque != "none" for joint in configs], np.bool_)
        self._indexes = np.array([i for i, _ in joints], np.int64)
        self._offset_ns = offset_ns

    def counters(self) -> dict[str, int]:
        """Return the sums of the joints' counters."""
        out = Counters().as_dict()
        for track in self.tracks:
            for key, value in track.counts.as_dict().items():
                out[key] += value
        return out

    def joint_counters(self) -> dict[int, dict[str, int]]:
        """Return the counters by index of the joint."""
        return {track.index: track.counts.as_dict() for track in self.tracks}

    def judge(
        self, raw: Raw, usable: NDArray[np.bool_], in_time: NDArray[np.bool_] | None = None
    ) -> Judged:
        """Judge the usable values, and accept those that are plausible.

        Parameters
        ----------
        usable, in_time : (k,) which values are usable, and which came in time; None: all did
        """
        joint = raw.joint
        position, torque = self.calibration.apply(joint, raw.position, raw.torque)
        torque[~(np.isfinite(torque) & self.senses[joint])] = np.nan
        order = np.flatnonzero(usable)
        order = order[np.argsort(joint[order], kind="stable")]
        counts = np.bincount(joint[order], minlength=len(self._indexes)).tolist()
        readings = Readings(
            sync=raw.number[order],
            t_ns=raw.t_ns[order],
            position_rad=position[order],
            torque_nm=torque[order],
            in_time=np.ones(len(order), np.bool_) if in_time is None else in_time[order],
        )
        found = self.tracks.judge(counts, readings)
        refused = [(int(order[place]), reason, fault) for place, reason, fault in found]
        accepted = usable.copy()
        for row, *_ in refused:
            accepted[row] = False
            counts[joint[row]] -= 1
        rows = slice(None) if accepted.all() else accepted
        samples = JointSamples(
            t_ns=raw.t_ns[rows] + self._offset_ns,
            t_receive_ns=raw.t_receive_ns[rows].astype(np.int64),
            joint=self._indexes[joint[rows]],
            position_rad=position[rows],
            torque_nm=torque[rows],
        )
        silent = np.flatnonzero(accepted & self.senses[joint] & np.isnan(torque)).tolist()
        return Judged(samples, counts, refused, silent)
