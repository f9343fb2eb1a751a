"""Compare the CAN nodes that send in a recording with the nodes of a configuration."""

import numpy as np

from fsw.config import Config
from fsw.config.signals import DESCRIBED
from fsw.drivers.layout.joints import all_layouts
from fsw.exchange.sinks import CanTraffic, Message, NullSink

TPDO1, HEARTBEAT = 0x180, 0x700


class Nodes(NullSink):
    """Collects, by bus, the numbers of the nodes that send TPDO1 or a heartbeat."""

    def __init__(self, config: Config) -> None:
        self._joints = [joint for joint in config.joints if joint.driver == "canopen"]
        self._tailored = {own.bus for own in config.can_nodes if own.driver == "canopen"} - {
            joint.bus for joint in config.joints if joint.driver == DESCRIBED
        }
        self._known = {(node.bus, node.node_id) for node in config.can_nodes} | {
            (bus.name, own.word - TPDO1)
            for bus in config.buses
            for layout in all_layouts(config, bus).values()
            for own in layout.messages
        }
        self._seen: set[tuple[str, int]] = set()

    def put(self, message: Message) -> None:
        """Record the senders of CAN frames; ignore other messages."""
        if isinstance(message, CanTraffic) and message.bus in self._tailored:
            ids = np.unique(message.frames["word"]).tolist()
            self._seen |= {(message.bus, i & 0x7F) for i in ids if i & ~0x7F in (TPDO1, HEARTBEAT)}

    def _strangers(self) -> list[str]:
        """Return a line for each bus on which nodes send that are not in the configuration."""
        others = sorted(node for node in self._seen - self._known if node[1])
        return [
            f"WRONG: {bus}: nodes {', '.join(f'0x{i:02x}' for b, i in others if b == bus)} send "
            "and are not nodes of the configuration; is the recording that of another robot?"
            for bus in sorted({bus for bus, _ in others})
        ]

    def _silent(self) -> list[str]:
        """Return a line for each bus on which some nodes send but a configured joint never does."""
        buses, lines = {bus for bus, _ in self._seen}, []
        for bus in sorted(buses):
            silent = [
                f"0x{joint.node_id:02x} ({joint.name})"
                for joint in self._joints
                if joint.bus == bus and (bus, joint.node_id) not in self._seen
            ]
            nodes = f"node{'s' if len(silent) > 1 else ''} {', '.join(silent)}"
            if silent:
                lines.append(
                    f"WRONG: {bus}: {nodes} never send{'s' if len(silent) == 1 else ''}; is the "
                    "recording that of another robot?"
                )
        return lines

    def findings(self) -> list[str]:
        """Return a line for each sign that the recording is of another robot."""
        return [*self._strangers(), *self._silent()]
