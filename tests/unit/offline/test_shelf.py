"""A long recording's blocks: those that are in a file give the bits of those in memory."""

import tracemalloc
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from fsw.estimators.batch.run import run_batch
from fsw.estimators.measurement import row_functions
from fsw.estimators.noise import creep
from fsw.messages import Block
from offline import shelf
from offline.shelf import Shelf
from tests.support.estimator_cases import (
    WINDOW_S,
    draw_biases,
    make_config,
    noisy,
    noisy_blocks,
    true_blocks_cached,
)

FEW = 16  # blocks that are read, or linearised, together
SECONDS = 16.0
BOUND = 2000  # bytes of memory for a further block; itself it has some 5000


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a recording of a minute a long one."""
    monkeypatch.setattr(shelf, "GROUP", FEW)
    monkeypatch.setattr(shelf, "IN_MEMORY", FEW)
    monkeypatch.setattr(row_functions, "MOST_BLOCKS", FEW)
    monkeypatch.setattr(creep, "GROUP", FEW)


@dataclass(frozen=True)
class Item:
    number: int
    values: np.ndarray


@pytest.mark.parametrize("count", [0, 1, FEW, FEW + 1, 3 * FEW, 3 * FEW + 5])
def test_a_shelf_is_a_list(count: int) -> None:
    items = [Item(k, np.array([k])) for k in range(count)]
    own = Shelf(items)
    assert (len(own), list(own), own[:]) == (count, items, items)
    for place in range(-count, count):
        assert own[place] == items[place]
    for part in (slice(5, 40), slice(None, None, 7), slice(None, None, -1)):
        assert own[part] == items[part]
    for beyond in (count, -count - 1):
        with pytest.raises(IndexError):
            own[beyond]


def repeated(times: int) -> Iterator[Block]:
    """Yield the blocks of a motion that is repeated after a gap, each time with other noise."""
    motion = true_blocks_cached("target", SECONDS)
    rng = np.random.default_rng(3)
    biases = draw_biases(rng)
    for k in range(times * len(motion)):
        block = noisy(motion[k % len(motion)], rng, biases)
        later_ns = k // len(motion) * (len(motion) + 1) * round(1e9 * WINDOW_S)
        yield replace(block, index=k, t_ns=block.t_ns + later_ns)


def test_a_batch_from_a_file_has_the_bits_of_one_from_memory() -> None:
    """Also with blocks twice, one that is not finite, and one that does not fit."""
    blocks = noisy_blocks("target", 3, 20.0)
    blocks[5] = replace(blocks[5], tau_nm=blocks[5].tau_nm * np.nan)
    blocks[20] = replace(blocks[20], tau_nm=blocks[20].tau_nm + 5.0)
    blocks.append(blocks[7])
    one = run_batch(make_config(), blocks, "fused", ())
    other = run_batch(make_config(), Shelf(blocks), "fused", ())
    assert one["gated"] == 3
    assert repr(one) == repr(other)


def peak_bytes(times: int) -> int:
    tracemalloc.start()
    run_batch(make_config(), Shelf(repeated(times)), "fused", ())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_the_memory_of_a_batch_does_not_grow_with_its_blocks() -> None:
    peak_bytes(1)  # what is made once for all
    few, many = peak_bytes(2), peak_bytes(6)
    assert (many - few) / (4 * len(true_blocks_cached("target", SECONDS))) < BOUND
