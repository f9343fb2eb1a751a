"""The two walks pass the rooms in order, with no more hops and forms than is allowed."""

from collections.abc import Iterator

import pytest

from hil.evidence import walks
from hil.evidence.walks import Walk, WalkedBench


@pytest.fixture(scope="module")
def bench() -> Iterator[WalkedBench]:
    with walks.warm_bench() as bench:
        yield bench


def check_rooms(walk: Walk, rooms: tuple[str, ...]) -> None:
    """Every room is entered, each after the one before."""
    names = list(walk.hops)
    first = [next(k for k, name in enumerate(names) if name.startswith(room)) for room in rooms]
    assert first == sorted(first)


@pytest.mark.slow
def test_a_torque_passes_every_room_from_its_frame_to_its_packet(bench: WalkedBench) -> None:
    walk = walks.torque_walk(bench)
    check_rooms(
        walk,
        (
            *("fsw.loop.loop", "fsw.exchange", "fsw.loop.estimation", "fsw.drivers"),
            *("fsw.scheduler.align", "fsw.estimators", "fsw.service", "fsw.telemetry"),
        ),
    )
    values = walk.values()
    names = values["names"]
    assert values["hops"] <= 65
    assert len(names[names.index("fsw.loop.estimation.process:work_off") :]) <= 55
    assert values["ring_crossings"] == 2
    assert values["forms"] <= 10


@pytest.mark.slow
def test_run_batch_passes_the_worker_and_comes_back_without_the_loop(bench: WalkedBench) -> None:
    walk = walks.batch_walk(bench)
    check_rooms(walk, ("fsw.telemetry.link", "fsw.service.worker", "fsw.estimators.batch"))
    assert not [name for name in walk.hops if name.startswith("fsw.loop")]
    values = walk.values()
    assert values["hops"] <= 35
    assert values["ring_crossings"] <= 2


def test_a_station_that_is_not_reached_is_named(bench: WalkedBench) -> None:
    with pytest.raises(RuntimeError, match="nowhere was not reached"):
        bench.walk((walks.Station("nowhere", "x", "int"),))
