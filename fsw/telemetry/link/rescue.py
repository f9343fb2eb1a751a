"""Telecommands that are accepted also when the numbers of their frames cannot be stored.

They free space, stop what fills the disk, or report what is on it. After a restart such a frame
could be sent again by somebody who recorded it, until the ground has sent a newer one.
"""

from fsw.telemetry.dictionary.codes import Mode
from fsw.telemetry.link.splitter import PacketSplitter
from fsw.telemetry.link.telecommands import TcError, TelecommandReader
from fsw.telemetry.link.uplink import KNOWN_ID

RESCUING = frozenset(
    {
        "PING",
        "REPORT_FREE_SPACE",
        "LIST_FILES",
        "DELETE_FILE",
        "DELETE_DIRECTORY",
        "ABORT_TRANSFER",
        "REC_STOP",
        "DELETE_STORED",
        "DISABLE_STORE",
        "SET_MODE",  # to SAFE only
    }
)


class Rescue:
    """Decides whether a frame contains only telecommands of `RESCUING`."""

    def __init__(self) -> None:
        self._reader = TelecommandReader()

    def __call__(self, packets: bytes) -> bool:
        """Return whether the data of a frame are whole packets, all of such telecommands."""
        splitter = PacketSplitter(KNOWN_ID)
        found = splitter.feed(packets, 0)
        whole = not (splitter.pending_bytes or splitter.skipped_bytes)
        return whole and bool(found) and all(self._helps(item.packet) for item in found)

    def _helps(self, packet: bytes) -> bool:
        try:
            request = self._reader.read(packet)
        except TcError:
            return False
        name = request.telecommand.name
        return name in RESCUING and (name != "SET_MODE" or request.whole("mode") == Mode.SAFE)
