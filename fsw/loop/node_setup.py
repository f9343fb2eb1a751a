"""Nodes of a bus that are set up by SDO before they are started: one request at a time each."""

from collections.abc import Callable

from fsw.drivers.codecs.canopen import NmtCommand, encode_nmt
from fsw.drivers.codecs.sdo import COB_REQUEST, Dialogue, is_answer
from fsw.drivers.wire import CanFrame

WAIT_NS = 500_000_000  # for a reply; then the request is sent again
TRIES = 4
Frame = tuple[int, bytes]  # identifier and data
Outcome = tuple[list[Frame], tuple[str, str, str] | None]  # frames to send, and an event


class NodeSetup:
    """The setup of one node: a dialogue with it, then its start.

    Parameters
    ----------
    node_id : CANopen number of the node
    name : name of its joint, for events
    begin : begins the dialogue, which ends with a fault in words, or without one
    """

    def __init__(self, node_id: int, name: str, begin: Callable[[], Dialogue]) -> None:
        self._node_id, self._name, self._begin = node_id, name, begin
        self._dialogue: Dialogue | None = None
        self._request = b""
        self._sent_ns, self._tries = 0, 0
        self.is_refused = False  # it differs from what is described, until it boots again

    @property
    def is_running(self) -> bool:
        """Whether replies are awaited."""
        return self._dialogue is not None

    def start(self, now_ns: int) -> list[Frame]:
        """Begin from the first request; return the frames to send."""
        self._dialogue, self.is_refused = self._begin(), False
        return [encode_nmt(NmtCommand.PRE_OPERATIONAL, self._node_id), *self._ask(b"", now_ns)[0]]

    def hear(self, frame: CanFrame, now_ns: int) -> Outcome:
        """Accept a reply; return frames to send, and an event: severity, code, text."""
        if not self.is_running or not is_answer(self._request, frame.data):
            return [], None
        return self._ask(frame.data, now_ns)

    def poll(self, now_ns: int) -> Outcome:
        """Repeat a request that has no reply; give up after `TRIES`."""
        if not self.is_running or now_ns - self._sent_ns < WAIT_NS:
            return [], None
        if self._tries >= TRIES:
            return self._ended("it does not answer SDO")
        self._tries, self._sent_ns = self._tries + 1, now_ns
        return [(COB_REQUEST + self._node_id, self._request)], None

    def _ask(self, reply: bytes, now_ns: int) -> Outcome:
        """Return the next request; at the end of the dialogue start the node unless it differs."""
        if self._dialogue is None:
            return [], None
        try:
            self._request = self._dialogue.send(reply) if reply else next(self._dialogue)
        except StopIteration as end:
            return self._ended(end.value)
        self._sent_ns, self._tries = now_ns, 1
        return [(COB_REQUEST + self._node_id, self._request)], None

    def _ended(self, fault: str) -> Outcome:
        self._dialogue, self.is_refused = None, bool(fault)
        subject = f"{self._name} (node 0x{self._node_id:02x})"
        if fault:
            return [], ("high", "NODE_DIFFERS", f"{subject}: {fault}; it is not started")
        started = encode_nmt(NmtCommand.START, self._node_id)
        return [started], ("info", "NODE_SET_UP", f"{subject}: its PDOs are as described")
