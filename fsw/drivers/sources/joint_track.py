"""One joint node: calibration, plausibility and bookkeeping of its samples."""

from __future__ import annotations

from fsw.config import JointConfig
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.encoder_watch import EncoderWatch
from fsw.drivers.wire import Reject
from fsw.messages.findings import Fault

HISTORY_SYNCS = 256  # SYNCs over which duplicates are known and losses settled
CHAIN = 3  # samples in unbroken, consistent order ...
CHAIN_S = 0.1  # ... over at least this time are believed against the last accepted one
SLACK_SIGMAS = 10.0
_MASK = (1 << HISTORY_SYNCS) - 1


def calibrate(config: JointConfig, position_rad: float, torque_nm: float) -> tuple[float, float]:
    """Apply sign, zero offset, gain and offset; position in the URDF's zero and sign.

    position = sign x raw - zero_offset, torque = sign x gain x raw - offset.
    """
    return (
        config.sign * position_rad - config.zero_offset_rad,
        config.sign * config.torque_gain * torque_nm - config.torque_offset_nm,
    )


class JointTrack:
    """State of one joint between frames; a rejected sample changes only counters."""

    def __init__(self, index: int, config: JointConfig, period_s: float) -> None:
        self.index = index
        self.config = config
        self.counts = Counters()
        self.first_sync = -1  # index of the first SYNC an accepted sample came for
        self.last_t_ns = 0
        self.fault: Fault | None = None  # what the newest sample was refused for
        self._last_rad = 0.0
        self._newest = 0
        self._seen = 0  # bit i: a sample for SYNC newest - i was accepted
        self._slack_rad = SLACK_SIGMAS * config.position_noise_rad
        self._slack_rad += config.speed_limit_rad_s * period_s
        self._encoder = EncoderWatch(period_s, config.speed_limit_rad_s, self._slack_rad)
        self._chain = 0
        self._chain_start_ns = 0
        self._doubted_t_ns = 0
        self._doubted_rad = 0.0

    def has(self, sync: int) -> bool:
        """Return whether a sample for the SYNC of this index was accepted."""
        back = self._newest - sync
        return 0 <= back < HISTORY_SYNCS and bool(self._seen >> back & 1)

    def judge(
        self, sync: int, t_ns: int, position_rad: float, torque_nm: float | None
    ) -> Reject | None:
        """Return why calibrated values for a SYNC are refused, or None and take them as seen.

        A node's frames never overtake one another, so a counter behind the last one is wrong. A
        torque of None is not judged.
        """
        self.fault = None
        first = self.first_sync < 0
        if not first and sync <= self._newest:
            return Reject.SEQUENCE
        limit_nm = self.config.torque_limit_nm
        if torque_nm is not None and not -limit_nm <= torque_nm <= limit_nm:
            self.fault = Fault.TORQUE_RANGE
            return Reject.RANGE
        self.fault = self._encoder.look(t_ns, position_rad)
        if self.fault is not None:
            return Reject.RANGE
        near = first or self._is_reachable(self.last_t_ns, self._last_rad, t_ns, position_rad)
        if not near and not self._is_believed(t_ns, position_rad):
            self.fault = Fault.ENCODER_JUMP
            return Reject.RANGE
        if first:
            self.first_sync = sync
            self._seen = 1
        else:
            self._seen = (self._seen << (sync - self._newest) | 1) & _MASK
        self._newest = sync
        self.last_t_ns, self._last_rad = t_ns, position_rad
        self._chain = 0
        return None

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
