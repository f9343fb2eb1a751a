"""Choice of the bus on which a node listens: slave side of ECSS-E-ST-50-15C, object 0x2000.

A node starts on Bdefault. Without the master's heartbeat for Ttoggle consumer heartbeat times the
node toggles to the other bus and increments Ctoggle. After Ntoggle toggles the node stays on its
bus. The bus on which the node receives the heartbeat becomes Bdefault; Ctoggle returns to zero.
"""

import struct
from dataclasses import dataclass

from hil.world.sensor_config import BusToggleConfig


@dataclass(slots=True)
class BusToggle:
    """Bus choice of one node; times in nanoseconds of the host's clock."""

    config: BusToggleConfig
    line: int = 0
    bdefault: int = 0
    ctoggle: int = 0
    _deadline_ns: int | None = None

    def power_on(self, t_ns: int) -> None:
        """Start on the bus Bdefault, which the node remembers over a power cycle."""
        self.line, self.ctoggle = self.bdefault, 0
        self._deadline_ns = t_ns + self._patience_ns()

    def heard(self, t_ns: int) -> None:
        """Accept the master's heartbeat on the node's present bus."""
        self.bdefault, self.ctoggle = self.line, 0
        self._deadline_ns = t_ns + self._patience_ns()

    def advance(self, t_ns: int) -> None:
        """Do all toggles that are due by this time."""
        while self._deadline_ns is not None and self._deadline_ns <= t_ns:
            self.line = 1 - self.line
            self.ctoggle += 1
            self._deadline_ns += self._patience_ns()
            if self.ctoggle >= self.config.ntoggle:
                self.bdefault, self._deadline_ns = self.line, None

    def objects(self) -> dict[tuple[int, int], bytes]:
        """Return the entries of the object dictionary by (index, subindex), as in an SDO upload."""
        config = self.config
        consumer = config.master_node_id << 16 | round(1e3 * config.consumer_heartbeat_s)
        values = (4, self.bdefault, config.ttoggle, config.ntoggle, self.ctoggle)
        entries = {(0x2000, i): bytes([value]) for i, value in enumerate(values)}
        return entries | {(0x1016, 0): b"\x01", (0x1016, 1): struct.pack("<I", consumer)}

    def _patience_ns(self) -> int:
        return round(1e9 * self.config.ttoggle * self.config.consumer_heartbeat_s)
