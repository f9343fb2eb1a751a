"""A stand-in for the daemon's authenticated link, and somebody on the way who adds reports."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from fsw.telemetry.link.sdls import RANDOM_BITS, Accepted, Association, FrameReceiver, FrameSplitter
from fsw.telemetry.link.sdls_numbers import NumberStore
from tests.support.fake_daemon import completed, report

KEY = bytes(range(32))
REPLAY = 15
Seal = Callable[[bytes], bytes]
Forge = Callable[[bytes], Sequence[bytes]]


class SealedDaemon:
    """Executes what is authentic and new, once, and reports it; `with` ends it.

    Parameters
    ----------
    forge : reports that somebody else sends about a telecommand before the daemon's own
    seal : makes what the daemon itself sends authentic
    copies : how often every frame arrives
    """

    def __init__(
        self,
        folder: Path,
        *,
        forge: Forge = lambda _packet: (),
        seal: Seal = lambda packet: packet,
        copies: int = 1,
        window: int = 64,
    ) -> None:
        self._numbers = NumberStore(folder / "daemon_numbers.json")
        self.receiver = FrameReceiver(
            [Association(spi=1, key=KEY)],
            self._numbers,
            spacecraft_id=42,
            virtual_channel=0,
            window=window,
        )
        self._forge, self._seal, self._copies = forge, seal, copies
        self.executed: list[bytes] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0.02)
        self.port = self._listener.getsockname()[1]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> SealedDaemon:
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._stop.set()
        self._thread.join()
        self._listener.close()
        self.receiver.settle()

    def skip_to(self, number: int) -> None:
        """Accept nothing below this number any more."""
        self._numbers.settle({Association(spi=1, key=KEY).fingerprint: number << RANDOM_BITS})

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                client, _ = self._listener.accept()
            except TimeoutError:
                continue
            with client:
                client.settimeout(0.02)
                self._serve(client)

    def _serve(self, client: socket.socket) -> None:
        splitter = FrameSplitter(self.receiver)
        while not self._stop.is_set():
            try:
                data = client.recv(65536)
                if not data:
                    return
                for outcome in splitter.feed(data * self._copies):
                    assert outcome.packet is not None
                    answers = list(self._forge(outcome.packet))
                    if isinstance(outcome, Accepted):
                        self.executed.append(outcome.packet)
                        answers += map(self._seal, completed(outcome.packet))
                    else:
                        values = {"error": REPLAY, "error_value": float(outcome.next_number or 0)}
                        refused = report("acceptance_failure", outcome.packet, **values)
                        answers.append(self._seal(refused))
                    client.sendall(b"".join(answers))
            except TimeoutError:
                continue
            except ConnectionError:
                return
