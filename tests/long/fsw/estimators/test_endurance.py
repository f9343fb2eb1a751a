"""Online estimators over 90 000 updates: bounded memory, finite factor, covariance of a batch.

One flight's blocks are pushed again and again, with new indices and times. The batch is the inverse
of the summed normal matrices of all rows folded in, accumulated apart from the estimator.
"""

import gc
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
import pytest

from evidence.methods.methods import METHODS, with_estimator
from fsw.estimators.recursive.online import OnlineEstimator, build_online
from fsw.messages import Block, FloatArray
from hil.run.processes import resident_bytes
from tests.support.estimator_cases import RATE_HZ, WINDOW_S, make_config, noisy_blocks, robot_model

BLOCKS = 450  # 90 000 joint sample sets of 500 Hz
FIRST_LOOK = BLOCKS // 2  # two laps of the flight, until which the store of blocks grows
ESTIMATORS = [name for name in METHODS if name != "ce"]  # there is no recursion of ce
COVARIANCE_BOUND = 1e-6
OWN_GROWTH_BYTES = 4096  # of the estimator, for longer integers; a float per block is 100 kB
LEAKED_OBJECTS = 0.1  # bound per block; an object kept per block is 1
SPARE_OBJECTS = 1000  # allowed for caches and free lists
RESIDENT_GROWTH_KB = 4096  # allowed for the allocator; an array kept per block is 100 MB


@dataclass(frozen=True, kw_only=True)
class Look:
    """The memory after a number of blocks."""

    own_bytes: int  # size of everything that is reachable from the estimator
    objects: int  # memory blocks allocated by the interpreter
    resident_kb: int


def is_flat(first: Look, last: Look, pushed: int) -> bool:
    """Return whether memory stays within its bounds over `pushed` blocks."""
    return (
        last.own_bytes - first.own_bytes < OWN_GROWTH_BYTES
        and last.objects - first.objects < SPARE_OBJECTS + LEAKED_OBJECTS * pushed
        and last.resident_kb - first.resident_kb < RESIDENT_GROWTH_KB
    )


def look(online: OnlineEstimator) -> Look:
    """Return the present memory after a garbage collection."""
    while online.recursion.memory.in_pass:  # which has memory of its own
        online.work()
    gc.collect()
    return Look(
        own_bytes=reachable_bytes(online),
        objects=sys.getallocatedblocks(),
        resident_kb=resident_bytes() // 1024,
    )


def reachable_bytes(root: object) -> int:
    """Return the size of an object and all objects that it refers to, without code and classes."""
    seen, waiting, size = {id(root)}, [root], 0
    while waiting:
        thing = waiting.pop()
        size += sys.getsizeof(thing)
        parts = [*gc.get_referents(thing)]
        if isinstance(thing, np.ndarray) and thing.base is not None:
            parts.append(thing.base)
        if isinstance(thing, FunctionType):
            parts = [cell.cell_contents for cell in thing.__closure__ or ()]
        for part in parts:
            if id(part) not in seen and not isinstance(part, type | ModuleType):
                seen.add(id(part))
                waiting.append(part)
    return size


class Tally:
    """Sums the normal matrix of the prior and of all rows that an estimator has used."""

    def __init__(self, online: OnlineEstimator) -> None:
        self._online, self._memory = online, online.recursion.memory
        R = self._memory.prior.R
        self._F: FloatArray = R.T @ R

    def push(self, block: Block) -> None:
        """Push a block; count its rows, or those of the block that leaves the store."""
        oldest = None if self._online.linear else next(iter(self._stored()), None)
        if self._online.linear:
            self._add(self._online.rows(block, self._online.problem.prior_mean, None).A)
        self._online.push(block)
        if oldest is not None and self._stored()[0] is not oldest:
            self._add(oldest.A)

    def covariance(self) -> FloatArray:
        """Return the covariance of the batch."""
        for stored in () if self._online.linear else self._stored():
            self._add(stored.A)
        scale = np.sqrt(np.diag(self._F))
        scaled = np.linalg.solve(self._F / np.outer(scale, scale), np.eye(len(self._F)))
        P: FloatArray = scaled / np.outer(scale, scale)
        return P

    def _stored(self) -> Sequence[Any]:
        return self._memory._store

    def _add(self, A: FloatArray) -> None:
        self._F = self._F + A.T @ A


@pytest.mark.parametrize("name", ESTIMATORS)
def test_memory_is_flat_and_the_covariance_is_the_batchs(name: str) -> None:
    plain = make_config(("target",), store_blocks=16)
    flight = noisy_blocks("target", 1, 30.0)
    assert 2 * len(flight) <= FIRST_LOOK
    online = build_online(
        with_estimator(plain, METHODS[name].method, METHODS[name].weighting), robot_model()
    )
    tally, looks, period_ns = Tally(online), list[Look](), round(WINDOW_S * 1e9)
    assert BLOCKS * WINDOW_S * RATE_HZ == 90_000
    for k in range(BLOCKS):
        lap, place = divmod(k, len(flight))
        online.work()
        t_ns = flight[place].t_ns + lap * len(flight) * period_ns
        tally.push(replace(flight[place], index=k, t_ns=t_ns))
        online.events()
        if k + 1 in (FIRST_LOOK, BLOCKS):
            looks.append(look(online))
    online.work()
    batch, got = tally.covariance(), online.recursion.memory.information.covariance()
    sigma = np.sqrt(np.diag(batch))
    first, last = looks
    assert is_flat(first, last, BLOCKS - FIRST_LOOK), looks
    assert np.all(np.isfinite(got))
    assert np.max(np.abs(got - batch) / np.outer(sigma, sigma)) < COVARIANCE_BOUND


@pytest.mark.parametrize(
    ("leak", "flat"),
    [
        ({}, True),
        ({"own_bytes": 10_000 + 24 * 4500}, False),  # a float per block of 4500
        ({"objects": 5_000 + 4500}, False),
        ({"resident_kb": 200_000 + 4500 * 2}, False),  # an array of 250 floats per block
    ],
)
def test_what_is_kept_per_block_is_a_leak(leak: dict[str, int], flat: bool) -> None:
    first = Look(own_bytes=10_000, objects=5_000, resident_kb=200_000)
    assert is_flat(first, replace(first, **leak), 4500) is flat


def test_reachable_bytes_sees_arrays_behind_views_closures_and_lists() -> None:
    whole = np.zeros(10_000)
    view = whole[:2]

    def closed() -> float:
        return float(view[0])

    assert reachable_bytes([closed]) > whole.nbytes
    assert reachable_bytes({"a": [np.zeros(5), np]}) < 1000
