import numpy as np
import pytest

from hil.devices.uart import SerialLine

BAUD = 921_600


def line(chunking: str, seed: int = 3) -> SerialLine:
    return SerialLine(BAUD, chunking, np.random.default_rng(seed), 0, 500.0)


def test_datagram_chunking_hands_over_at_the_last_byte():
    end = line("datagram")
    end.send([1_000_000], [bytes(42)])
    assert end.next_ns() == 1_000_000 + round(42 * 10e9 / BAUD)
    assert end.take(1_000_000 + 455_728) == []
    assert [data for _, data in end.take(1_000_000 + 455_730)] == [bytes(42)]


@pytest.mark.parametrize("chunking", ["ms1", "random"])
def test_no_byte_comes_before_it_has_crossed_and_none_is_lost(chunking):
    end = line(chunking)
    blocks = [bytes([k % 256]) * 42 for k in range(500)]
    starts = [2_000_000 * k for k in range(500)]
    crossed = np.concatenate([s + np.arange(1, 43) * 10e9 / BAUD for s in starts])
    received = 0
    for k in range(0, 500, 50):
        end.send(starts[k : k + 50], blocks[k : k + 50])
        end.complete(starts[k] + 100_000_000)
        for arrival, data in end.take(starts[k] + 100_000_000):
            received += len(data)
            assert arrival >= crossed[received - 1] - 1.0
            assert arrival - crossed[received - len(data)] < 50e6
    end.complete(2_000_000_000)
    rest = end.take(2_000_000_000)
    assert received + sum(len(data) for _, data in rest) == 500 * 42


@pytest.mark.parametrize("chunking", ["ms1", "random"])
def test_chunks_do_not_align_with_datagrams(chunking):
    end = line(chunking)
    end.send([2_000_000 * k for k in range(2000)], [bytes(42)] * 2000)
    end.complete(4_000_000_000)
    sizes = {len(data) for _, data in end.take(4_000_000_000)}
    assert len(sizes) > 10


def test_ms1_chunks_are_whole_frames_apart():
    end = line("ms1")
    end.send([2_000_000 * k for k in range(500)], [bytes(42)] * 500)
    end.complete(1_000_000_000)
    gaps = np.diff([arrival for arrival, _ in end.take(1_000_000_000)]) / 1e6
    assert np.abs(gaps - np.rint(gaps)).max() < 2 * 500e-6 + 1e-5


@pytest.mark.parametrize("chunking", ["datagram", "ms1", "random"])
def test_chunks_do_not_depend_on_when_the_line_is_looked_at(chunking):
    results = []
    for step in (1, 7):
        end = line(chunking)
        chunks = []
        for k in range(140):
            end.send([2_000_000 * k], [bytes([k]) * 42])
            end.complete(2_000_000 * (k + 1))
            if k % step == step - 1:
                end.next_ns()
                chunks += end.take(2_000_000 * (k + 1))
        results.append(chunks)
    assert results[0] == results[1]
