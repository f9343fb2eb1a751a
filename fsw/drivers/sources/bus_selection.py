"""Choice of the active bus of two redundant ones: the master's part of ECSS-E-ST-50-15C.

The master sends SYNC and its heartbeat on the active bus only. A node that misses the heartbeat
toggles between the buses until it receives the heartbeat again. So the master may switch: it does
when it receives no node on the active bus any more, or when its port there is down.
"""

from fsw.config import RedundantBusConfig

STALL_PART = 5  # a stall counts as silence of at most this part of `lost_after_s`
NAMES = ("nominal", "redundant")


class BusSelector:
    """Selects the active bus from the nodes' frames on it.

    Silence is measured from poll to poll. During a stall of the loop frames may wait unread, so
    only a part of a stall counts as silence.
    """

    def __init__(self, config: RedundantBusConfig) -> None:
        self._lost_ns = round(config.lost_after_s * 1e9)
        # Nodes may toggle away and back once before they meet the master: wait for both toggles.
        self._search_ns = self._lost_ns + round(2 * config.nodes_toggle_s * 1e9)
        self.active = 0
        self.switches = 0
        self._heard = False  # whether a node was received since the bus became active
        self._just_heard = False  # whether a node was received since the last poll
        self._quiet_ns = 0
        self._polled_ns: int | None = None

    @property
    def name(self) -> str:
        """Name of the active bus."""
        return NAMES[self.active]

    def hear(self) -> None:
        """Record that a frame of a configured node was received on the active bus."""
        self._heard = self._just_heard = True

    def poll(self, now_ns: int, up: tuple[bool, bool]) -> str:
        """Switch if the active bus is lost and the other port is up; return the reason, or ''."""
        if self._just_heard or self._polled_ns is None:
            self._quiet_ns = 0
        else:
            self._quiet_ns += min(now_ns - self._polled_ns, self._lost_ns // STALL_PART)
        self._just_heard, self._polled_ns = False, now_ns
        if not up[1 - self.active]:
            return ""
        if not up[self.active]:
            reason = "the port is down"
        elif self._quiet_ns > (self._lost_ns if self._heard else self._search_ns):
            reason = f"no frame of any node for {self._quiet_ns * 1e-9:.2f} s"
        else:
            return ""
        self.active = 1 - self.active
        self.switches += 1
        self._heard = False
        self._quiet_ns = 0
        return reason
