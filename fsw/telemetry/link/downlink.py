"""Makes time-stamped packets of everything that is sent down, and passes them to the link."""

from collections.abc import Callable, Mapping

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.types import Packet
from fsw.telemetry.link.outbox import Priority
from fsw.telemetry.link.packets import Packetizer

FIRST = ("health", "time", "time_correlation")
DUMPED = (
    "event_log_entry",
    "command_log_entry",
    "file_entry",
    "schedule_entry",
    "schedule_detail",
    "sequence_status",
    "sequence_entry",
    "event_action_status",
    "transfer_status",
    "monitor_definition",
    "monitor_status",
)


def _priority(packet: Packet) -> Priority:
    """Return the priority of a packet of the dictionary."""
    if packet.name in FIRST or packet.service == 1:
        return Priority.HEALTH
    if packet.service == 5 or packet.name == "check_transition":
        return Priority.EVENT
    if packet.name == "science":
        return Priority.SCIENCE
    if packet.name in DUMPED:
        return Priority.DUMP
    is_set = (packet.service, packet.subtype) == (3, 25)
    return Priority.HOUSEKEEPING if is_set else Priority.ANSWER


PRIORITIES = {packet.name: _priority(packet) for packet in DICTIONARY.packets}


class Downlink:
    """Makes packets and passes them to the packet stores and, if there is one, to the link."""

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._packetizer = Packetizer()
        self.out: Callable[[bytes, Priority], None] | None = None
        self.keep: Callable[[bytes], None] | None = None  # stores new packets

    def send(self, name: str, values: Mapping[str, object], t_ns: int | None = None) -> None:
        """Send a packet of the dictionary, stamped with `t_ns` [ns] or with the present time."""
        t_ns = self._now_ns() if t_ns is None else t_ns
        self._pass(self._packetizer.make(name, t_ns, values), PRIORITIES[name])

    def wrap(self, packet: Packet, t_ns: int, data: bytes) -> None:
        """Send a packet; `data` holds its packed fields."""
        self._pass(self._packetizer.wrap(packet, t_ns, data), PRIORITIES[packet.name])

    def file_unit(self, pdu: bytes) -> None:
        """Send a unit of file delivery."""
        self._pass(self._packetizer.file_packet(pdu), Priority.DUMP)

    def time(self, exponent: int) -> None:
        """Send a time packet that reports the rate exponent and the present time."""
        t_ns = self._now_ns()
        coarse, rest_ns = divmod(t_ns, 1_000_000_000)
        values = {
            "rate_exponent": exponent,
            "p_field": 0x2F,
            "coarse_s": coarse & 0xFFFFFFFF,
            "fine": (rest_ns << 24) // 1_000_000_000,
            "time_status": 0,
        }
        self.send("time", values, t_ns)

    def again(self, packet: bytes) -> None:
        """Send a stored packet again, unchanged."""
        if self.out is not None:
            self.out(packet, Priority.DUMP)

    def _pass(self, packet: bytes, priority: Priority) -> None:
        if self.keep is not None:
            self.keep(packet)
        if self.out is not None:
            self.out(packet, priority)
