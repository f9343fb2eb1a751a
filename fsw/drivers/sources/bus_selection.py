"""Which of two redundant buses is the active one: the master's side of ECSS-E-ST-50-15C.

The master sends SYNC and its heartbeat on the active bus only. A node that misses the heartbeat
toggles between the buses until it finds it again. So the master is free to change: it does when no
node is received on the active bus any more, or when its own port there is down.
"""

from fsw.config import RedundantBusConfig

STALL_PART = 5  # a stall of the loop counts for a fifth of what makes a bus lost, at most
NAMES = ("nominal", "redundant")


class BusSelector:
    """Decides from the nodes' frames on the active bus.

    Silence is what the loop has seen of it: of a stall of the loop itself, in which frames may wait
    unread or the whole machine stood still, no more than a part counts.
    """

    def __init__(self, config: RedundantBusConfig) -> None:
        self._lost_ns = round(config.lost_after_s * 1e9)
        # Nodes that left just before the master may toggle away and back before they meet it.
        self._search_ns = self._lost_ns + round(2 * config.nodes_toggle_s * 1e9)
        self.active = 0
        self.switches = 0
        self._heard = False  # since the bus became active
        self._just_heard = False  # since the last poll
        self._quiet_ns = 0
        self._polled_ns: int | None = None

    @property
    def name(self) -> str:
        """Name of the active bus."""
        return NAMES[self.active]

    def hear(self) -> None:
        """Note a frame of a configured node, read from the active bus just now."""
        self._heard = self._just_heard = True

    def poll(self, now_ns: int, up: tuple[bool, bool]) -> str:
        """Switch when the active bus is lost and the other is there; return why, or nothing."""
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
