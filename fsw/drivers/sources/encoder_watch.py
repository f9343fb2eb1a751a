"""Watch over one joint's encoder: it finds jumps, and readings that stand while the joint moves.

A joint cannot move faster than its limit, so a larger step between two samples is a fault of the
encoder. Such steps are summed: when a step back makes the sum zero, positions are trusted again. A
jump that lasts longer than `HOLD_S` is accepted, because no estimate is possible without positions.
"""

from fsw.messages.findings import Fault

GAP_PERIODS = 3.5  # after a longer gap the watch starts again
CONFIDENT_SAMPLES = 50  # samples in a row before a step makes the newer sample faulty
HOLD_S = 10.0
STUCK_SAMPLES = 3  # equal readings ...
STUCK_RATE_RATIO = 0.02  # ... while the rate is above this part of the speed limit
STUCK_STEPS = 20.0  # ... over more of the encoder's steps; where a joint turns back fewer are equal
RATE_GAIN = 0.125  # gain of the running mean of the rate


class EncoderWatch:
    """Judges the positions of one joint, sample by sample, each against the one before."""

    def __init__(
        self,
        period_s: float,
        speed_limit_rad_s: float,
        slack_rad: float,
        step_rad: float = 0.0,
    ) -> None:
        """`step_rad`: resolution of the encoder; 0: so fine that a moving joint shows it."""
        self._gap_ns = GAP_PERIODS * period_s * 1e9
        self._slack_rad = slack_rad
        self._stuck_rate_rad_s = STUCK_RATE_RATIO * speed_limit_rad_s
        self._stuck_rad_s = STUCK_STEPS * step_rad / period_s  # rate times equal readings
        self._t_ns = 0
        self._position = 0.0
        self._restart()

    def _restart(self) -> None:
        self._run = 0  # samples in a row without a step
        self._equal = 0
        self._stuck = False
        self._rate = 0.0
        self._offset = 0.0  # sum of the steps
        self._since_ns = 0

    @property
    def is_steady(self) -> bool:
        """Whether neither a jump nor a stuck encoder is present now."""
        return not (self._offset or self._stuck)

    @property
    def newest(self) -> tuple[int, float, float]:
        """Newest sample's time [ns] and position [rad], and the mean of the rate [rad/s]."""
        return self._t_ns, self._position, self._rate

    def follow(self, t_ns: int, position_rad: float, rate: float, count: int, equal: int) -> None:
        """Accept `count` faultless samples at once, of which only the last one is given.

        Parameters
        ----------
        t_ns, position_rad : time and position of the last sample
        rate : running mean of the rate there [rad/s]
        equal : number of equal readings in a row there
        """
        self._t_ns, self._position, self._rate = t_ns, position_rad, rate
        self._run += count
        self._equal = equal if equal < count else self._equal + equal

    def look(self, t_ns: int, position_rad: float) -> Fault | None:
        """Accept the next position; return its fault, or None."""
        dt_ns, step = t_ns - self._t_ns, position_rad - self._position
        self._t_ns, self._position = t_ns, position_rad
        if not 0 < dt_ns <= self._gap_ns:
            self._restart()
            return None
        if step == 0.0 and self._is_stuck():
            return Fault.ENCODER_STUCK
        periods = 1
        if step != 0.0:
            periods += self._equal  # a coarse encoder shows a slow motion now and then
            self._equal = 0
            if self._stuck:  # the joint moved while the encoder was stuck: accept any position
                self._restart()
                return None
        self._add(step, dt_ns * 1e-9, periods, t_ns)
        if abs(self._offset) <= self._slack_rad:
            self._offset = 0.0
            return None
        return Fault.ENCODER_JUMP

    def _add(self, step: float, dt_s: float, periods: int, t_ns: int) -> None:
        """Add a step to the rate if the joint could make it, else to the offset.

        `periods`: samples since the step before, for which the joint has moved.
        """
        jump = step - self._rate * dt_s
        if abs(jump) > self._slack_rad:
            if self._run < CONFIDENT_SAMPLES and not self._offset:
                self._restart()
                return
            if not self._offset:
                self._since_ns = t_ns
            self._offset += jump
        elif step != 0.0 or abs(self._rate) < self._stuck_rate_rad_s:
            self._rate += RATE_GAIN * (step / (dt_s * periods) - self._rate)
            self._run += 1
        if self._offset and t_ns - self._since_ns > HOLD_S * 1e9:
            self._restart()

    def _is_stuck(self) -> bool:
        self._equal += 1
        moving = abs(self._rate) > self._stuck_rate_rad_s
        # the first of the equal readings came with a step
        moving &= self._equal * abs(self._rate) > self._stuck_rad_s
        if self._equal >= STUCK_SAMPLES - 1 and moving and self._run >= CONFIDENT_SAMPLES:
            self._stuck = True
        return self._stuck
