"""The estimation's end of the ring."""

import os
from types import SimpleNamespace

from fsw.estimation.process import work_off
from fsw.exchange.ring import RingReader, RingWriter
from fsw.exchange.ringlink import TO_ESTIMATION, RingSink
from fsw.exchange.sinks import BatchEnd
from fsw.messages.commands import Command, CommandName


class Taker:
    """An estimation that fails at a command."""

    def __init__(self) -> None:
        self.aligner = SimpleNamespace(deadline_ns=None, grid_ns=None)
        self.taken: list = []

    def put(self, message) -> None:
        self.taken.append(message)
        if isinstance(message, Command):
            raise RuntimeError("nobody foresaw this")
        self.aligner.deadline_ns, self.aligner.grid_ns = message.now_ns + 5, 3


def test_what_has_ended_an_estimation_does_not_end_the_next() -> None:
    ring = RingWriter.create(1 << 16)
    sink = RingSink(ring, TO_ESTIMATION)
    sink.put(BatchEnd(now_ns=10))
    sink.put(Command(name=CommandName.RESET))
    sink.put(BatchEnd(now_ns=20))
    first, second = Taker(), Taker()
    try:
        work_off(first, RingReader(os.dup(ring.fd)))
    except RuntimeError:
        assert ring.notes == (15, 3)
    else:
        raise AssertionError("the command was taken")
    following = RingReader(os.dup(ring.fd))
    assert work_off(second, following)
    assert second.taken == [BatchEnd(now_ns=20)]
    assert ring.notes == (25, 3)
    sink.close()
    assert not work_off(second, following)
