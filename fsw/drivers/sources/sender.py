"""Order and time of the datagrams of one sender: which are new, and when their values were valid.

Times of this machine's monotonic clock are used as they are. Any other clock is fitted under the
arrivals, by the time of sending (`clock_model`); so delays of the network spread no sample.

A datagram is new if its sequence number and both its times are later than those of the newest one,
by no more than the time that has passed allows. A sender that restarts begins anywhere. Without a
key, 0.1 s of datagrams in order are believed to be a restart. With a key nobody else can send a
later time, so that it is believed at once and an earlier one never.
"""

from dataclasses import dataclass
from enum import Enum

from fsw.config.feed import FeedConfig
from fsw.drivers.codecs.feed import Datagram
from fsw.drivers.sources.clock_model import ClockModel
from fsw.drivers.wire import Reject

MODULUS = 1 << 32
MOST_AGE_NS = 1_000_000_000  # from validity to sending
CHAIN, CHAIN_NS = 3, 100_000_000  # this many in order over this time are believed
MOST_RATE = 2.0  # multiple of the declared rate at which a sender's numbers may grow
SPARE = 16  # numbers that may be skipped besides
YOUNG_NS = 1_000_000_000  # time after which the clock model has seen a prompt arrival


class Order(Enum):
    """Verdict on a datagram's place among the others."""

    NEXT = "next"
    RESTART = "the sender restarted"
    DOUBLED = "sent twice"
    OLD = "overtaken by a newer one, or replayed"
    DOUBTED = "out of order"
    UNTIMED = "its times contradict each other or the arrival"

    @property
    def reason(self) -> Reject | None:
        """Counter of a refused datagram; None: it is not refused."""
        if self in (Order.NEXT, Order.RESTART):
            return None
        return Reject.STALE if self is Order.UNTIMED else Reject.SEQUENCE


@dataclass(frozen=True, slots=True)
class Timed:
    """Times of an accepted datagram on this machine's clock [ns]."""

    index: int  # running number, without wraps and restarts
    t_valid_ns: int
    late_ns: float  # from sending to arrival, minus the least delay if the clock is fitted
    lost: int  # datagrams missing before it


class SenderTrack:
    """Datagrams of one kind of one sender.

    Parameters
    ----------
    rate_hz : nominal rate
    """

    def __init__(self, feed: FeedConfig, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._is_keyed = feed.key_file is not None
        is_fitted = feed.clock != "monotonic"
        self._clock = ClockModel(1e-9, feed.clock_tolerance_ppm) if is_fitted else None
        self._newest: Datagram | None = None
        self._began_ns = 0  # of the sender's clock, when its model began
        self._index = -1
        self._doubted: Datagram | None = None
        self._chain, self._chain_start_ns = 0, 0

    def judge(self, item: Datagram, t_ns: int) -> Order:
        """Judge a datagram received at `t_ns` without accepting it."""
        is_timely = item.t_valid_ns <= item.t_sent_ns <= item.t_valid_ns + MOST_AGE_NS
        if not is_timely or (self._clock is None and item.t_sent_ns > t_ns):
            return Order.UNTIMED
        newest = self._newest
        if newest is None:
            return Order.NEXT
        return self._beside(newest, item, t_ns)

    def _beside(self, newest: Datagram, item: Datagram, t_ns: int) -> Order:
        """Judge a datagram by the newest accepted one."""
        is_later = item.t_sent_ns > newest.t_sent_ns and item.t_valid_ns > newest.t_valid_ns
        if not is_later and (self._is_keyed or item.sequence == newest.sequence):
            is_same = (item.sequence, item.t_sent_ns) == (newest.sequence, newest.t_sent_ns)
            return Order.DOUBLED if is_same else Order.OLD
        if is_later and self._follows(item, newest) and not self._is_early(item, t_ns):
            return Order.NEXT
        if self._is_keyed or self._is_believed(item, t_ns):
            return Order.RESTART
        return Order.DOUBTED if is_later else Order.OLD

    def accept(self, item: Datagram, t_ns: int, order: Order) -> Timed:
        """Accept a datagram that `judge` found NEXT or RESTART."""
        steps, clock = 1, self._clock
        if order is Order.NEXT and self._newest is not None:
            steps = (item.sequence - self._newest.sequence) % MODULUS
        if clock is not None:
            if order is Order.RESTART:
                clock.reset()
            if not clock.ready:
                self._began_ns = item.t_sent_ns
            clock.observe(item.t_sent_ns, t_ns, 0.0)
        self._newest, self._doubted, self._chain = item, None, 0
        self._index += steps
        if clock is None:
            return Timed(self._index, item.t_valid_ns, t_ns - item.t_sent_ns, steps - 1)
        reference_ns, rest_ns = clock.predict_ns(item.t_sent_ns)
        sent_ns = reference_ns + round(rest_ns)
        valid_ns = sent_ns - (item.t_sent_ns - item.t_valid_ns)
        return Timed(self._index, valid_ns, t_ns - sent_ns, steps - 1)

    def _follows(self, item: Datagram, before: Datagram) -> bool:
        """Return whether the sequence number advanced by no more than the time allows."""
        ahead = (item.sequence - before.sequence) % MODULUS
        passed_s = (item.t_sent_ns - before.t_sent_ns) * 1e-9
        return 0 < ahead <= SPARE + MOST_RATE * passed_s * self._rate_hz

    def _is_early(self, item: Datagram, t_ns: int) -> bool:
        """Return whether a datagram arrived before the sender's clock says that it was sent."""
        clock = self._clock
        if clock is None or item.t_sent_ns - self._began_ns < YOUNG_NS:
            return False
        return clock.early_ns(item.t_sent_ns, t_ns) > 1e9 / self._rate_hz

    def _is_believed(self, item: Datagram, t_ns: int) -> bool:
        before, self._doubted = self._doubted, item
        in_order = (
            before is not None
            and item.t_sent_ns > before.t_sent_ns
            and item.t_valid_ns > before.t_valid_ns
            and self._follows(item, before)
        )
        if not in_order:
            self._chain, self._chain_start_ns = 0, t_ns
        self._chain += 1
        return self._chain >= CHAIN and t_ns - self._chain_start_ns >= CHAIN_NS
