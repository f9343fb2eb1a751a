from hypothesis import given
from hypothesis import strategies as st

from fsw.drivers.codecs.framing import Framer, Piece
from fsw.drivers.codecs.stim300 import StimMatcher
from fsw.drivers.wire import ByteChunk, Reject
from tests.support.encoders import Stim

GOOD = Stim(0x90, {"g": (1, 2, 3)}).encode()


def test_pieces_tell_in_which_chunks_a_frame_came() -> None:
    framer = Framer(StimMatcher(crlf=False))
    stream = b"xy" + GOOD + GOOD
    assert framer.feed(ByteChunk(10, stream[:5])) == []
    assert framer.feed(ByteChunk(20, stream[5:9])) == []
    first, second = framer.feed(ByteChunk(30, stream[9:]))
    assert first.pieces == (Piece(0, 10, 3), Piece(1, 20, 4), Piece(2, 30, 11))
    assert second.pieces == (Piece(2, 30, 18),)


def test_bytes_before_the_first_frame_are_skipped_and_no_reject() -> None:
    framer = Framer(StimMatcher(crlf=False))
    framer.feed(ByteChunk(0, GOOD[5:] + GOOD))
    assert sum(framer.rejects.values()) == 0
    assert framer.skipped_bytes == 13


def test_each_broken_frame_counts_once() -> None:
    framer = Framer(StimMatcher(crlf=False))
    broken = GOOD[:-1] + bytes([GOOD[-1] ^ 1])
    framer.feed(ByteChunk(0, GOOD + 3 * broken + GOOD + b"\x00" * 5 + GOOD))
    assert framer.rejects == {Reject.CRC: 3, Reject.SYNC: 1}


@given(st.lists(st.sampled_from([GOOD, GOOD[:7], b"\x90", b"junk"]), max_size=30), st.data())
def test_chunking_never_matters(parts: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(parts)
    whole, cut = Framer(StimMatcher(crlf=False)), Framer(StimMatcher(crlf=False))
    frames = [f.data for f in whole.feed(ByteChunk(0, stream))]
    found, at = [], 0
    while at < len(stream):
        size = data.draw(st.integers(1, 9))
        found += [f.data for f in cut.feed(ByteChunk(0, stream[at : at + size]))]
        at += size
    assert found == frames
    assert cut.rejects == whole.rejects
    assert cut.skipped_bytes == whole.skipped_bytes
    assert cut.pending_bytes == whole.pending_bytes
