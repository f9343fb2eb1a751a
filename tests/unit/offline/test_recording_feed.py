"""The messages of a recording in batches; a jump of the clock takes no time."""

from pathlib import Path

from fsw.drivers.wire import CanFrame, frame_array
from fsw.exchange.recording import pieces_of
from fsw.exchange.recording_writer import RecordingWriter
from fsw.exchange.sinks import BatchEnd, CanTraffic
from offline.replay import LONGEST_GAP_NS, RecordingFeed

SECOND = 10**9
YEARS = 1_700_000_000 * SECOND


def feed_of(path: Path, times_ns: list[int]) -> RecordingFeed:
    writer = RecordingWriter(path, chunk_bytes=4096)
    for t_ns in times_ns:
        writer.traffic(CanTraffic("arm", frame_array([CanFrame(t_ns, 0x80, b"\x01")])))
    writer.close()
    return RecordingFeed(pieces_of([path], ["/can/arm"]), ["/can/arm"])


def replayed(feed: RecordingFeed) -> tuple[list[int], list[int]]:
    """Return the times of the frames, and of the ends of batches."""
    frames, ends = [], []
    while not feed.exhausted:
        for message in feed.next_batch(SECOND):
            if isinstance(message, BatchEnd):
                ends.append(message.now_ns)
            else:
                frames += message.frames["t_ns"].tolist()
    return frames, ends


def test_a_jump_of_the_clock_is_skipped_but_for_its_last_hour(tmp_path: Path):
    before, after = [k * SECOND for k in range(3)], [YEARS + k * SECOND for k in range(3)]
    frames, ends = replayed(feed_of(tmp_path / "jump.mcap", before + after))
    assert frames == before + after
    assert len(ends) < LONGEST_GAP_NS // SECOND + 10
    assert ends == sorted(ends)


def test_an_hour_without_messages_is_replayed_whole(tmp_path: Path):
    _, ends = replayed(feed_of(tmp_path / "gap.mcap", [0, 3500 * SECOND]))
    assert ends == [k * SECOND for k in range(1, 3501)]
