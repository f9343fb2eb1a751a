import os
import random
import subprocess
import sys

import pytest

from fsw.exchange.ring import RingReader, RingWriter

CHILD = """
import os, sys
from fsw.exchange.ring import RingReader
ring = RingReader(int(sys.argv[1]))
want, total, bad = int(sys.argv[2]), 0, 0
while total < want:
    for kind, payload in ring.read():
        bad += payload != bytes([kind]) * (total % 97)
        total += 1
print(total, bad)
"""


@pytest.fixture
def ring():
    writer = RingWriter.create(1024)
    reader = RingReader(os.dup(writer.fd))
    yield writer, reader
    reader.close()
    writer.close()


def test_records_come_out_in_order_with_kind_and_payload(ring):
    writer, reader = ring
    assert writer.push(3, b"abc")
    assert writer.push(4, b"")
    assert list(reader.read()) == [(3, b"abc"), (4, b"")]
    assert list(reader.read()) == []
    assert (writer.records, writer.dropped, writer.used_bytes) == (2, 0, 0)


def test_any_sizes_survive_many_wraps(ring):
    writer, reader = ring
    rng = random.Random(1)
    for k in range(5000):
        payloads = [rng.randbytes(rng.randrange(300)) for _ in range(rng.randrange(3))]
        for payload in payloads:
            assert writer.push(k % 250, payload)
        assert [p for _, p in reader.read()] == payloads
    assert writer.dropped == 0


def test_a_full_ring_drops_and_counts_the_new_record_and_keeps_the_old(ring):
    writer, reader = ring
    taken = [k for k in range(100) if writer.push(1, bytes([k]) * 40)]
    assert taken == list(range(len(taken)))
    assert writer.dropped == 100 - len(taken) > 0
    assert reader.dropped == writer.dropped
    assert [p[0] for _, p in reader.read()] == taken
    assert writer.push(1, b"again")
    assert list(reader.read()) == [(1, b"again")]


def test_a_record_larger_than_the_ring_is_dropped(ring):
    writer, reader = ring
    assert not writer.push(1, bytes(2000))
    assert writer.dropped == 1
    assert list(reader.read()) == []


def test_a_limit_leaves_the_rest_for_later(ring):
    writer, reader = ring
    for k in range(5):
        writer.push(k, b"x")
    assert [k for k, _ in reader.read(2)] == [0, 1]
    assert [k for k, _ in reader.read()] == [2, 3, 4]


def test_a_record_not_visible_in_whole_yet_is_left(ring):
    writer, reader = ring
    writer.push(1, b"payload")
    writer._data[16] ^= 0xFF
    assert list(reader.read()) == []
    writer._data[16] ^= 0xFF
    assert list(reader.read()) == [(1, b"payload")]


def test_another_process_reads_everything_by_the_inherited_descriptor():
    writer = RingWriter.create(4096)
    count = 20_000
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(writer.fd), str(count)],
        pass_fds=(writer.fd,),
        stdout=subprocess.PIPE,
    )
    sent = 0
    while sent < count and child.poll() is None:
        sent += writer.push(sent % 251, bytes([sent % 251]) * (sent % 97))
    out, _ = child.communicate(timeout=60)
    writer.close()
    assert out.split() == [str(count).encode(), b"0"]


@pytest.mark.parametrize("capacity", [0, 100])
def test_a_capacity_off_the_alignment_is_refused(capacity: int):
    with pytest.raises(ValueError, match="capacity_bytes"):
        RingWriter.create(capacity)


@pytest.mark.parametrize("once", [False, True])
def test_what_a_reader_was_at_when_it_died_is_there_for_the_next_unless_it_reads_once(ring, once):
    writer, reader = ring
    for kind in (1, 2):
        writer.push(kind, b"x")
    dying = reader.read(once=once)
    assert next(dying).kind == 1
    following = RingReader(os.dup(writer.fd))  # before the first has come back for more
    assert [record.kind for record in following.read()] == ([2] if once else [1, 2])
    following.close()


def test_the_writer_and_the_next_reader_see_what_a_reader_left(ring):
    writer, reader = ring
    assert writer.notes == (0, 0)
    reader.note(7, 1 << 60)
    following = RingReader(os.dup(writer.fd))
    assert writer.notes == following.notes == (7, 1 << 60)
    following.close()
