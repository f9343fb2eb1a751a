"""Both ends over links that lose: LibreCube's implementation, two of ours, spoiled units."""

import filecmp
import gc
import io
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from file_delivery import incoming, library
from file_delivery.entity import FileEntity
from file_delivery.library import DAEMON, GROUND, Pair
from tests.support.delivery_cases import S, Uplink, content, drain


def lossy(rng: np.random.Generator, ratio: float) -> Callable[[list[bytes]], list[bytes]]:
    return lambda units: [unit for unit in units if rng.random() >= ratio]


@pytest.fixture
def quick_timers(monkeypatch):
    monkeypatch.setattr(library, "TIMER_S", 0.02)
    monkeypatch.setattr(incoming, "TIMER_S", 0.02)
    monkeypatch.setattr(library, "TIMER_LIMIT", 500)


@pytest.fixture
def librecube(tmp_path: Path) -> Iterator[Callable[..., object]]:
    """Return a maker of LibreCube's entity on a list as its link."""
    cfdp = pytest.importorskip("cfdp", reason="needs cfdp (LibreCube): pip install '.[test]'")
    from cfdp.filestore import NativeFileStore
    from cfdp.transport.base import Transport

    made = []

    class ListTransport(Transport):
        def __init__(self) -> None:
            super().__init__()
            self.sent: list[bytes] = []

        def request(self, pdu: bytes) -> None:
            self.sent.append(bytes(pdu))

    def make(folder: Path):
        transport = ListTransport()
        entity = cfdp.CfdpEntity(
            entity_id=GROUND,
            filestore=NativeFileStore(str(folder)),
            transport=transport,
            nak_timer_interval=0.05,
            nak_timer_expiration_limit=500,
            positive_ack_timer_interval=0.05,
            positive_ack_timer_expiration_limit=500,
        )
        made.append(entity)
        return entity, transport

    yield make
    for entity in made:
        entity.shutdown()
        entity._event_thread.join()
        entity._message_thread.join()
    for thing in gc.get_objects():  # it leaves the file it sends open; a proxy's class is not asked
        if type(thing) is io.BufferedReader and str(thing.name).startswith(str(tmp_path)):
            thing.close()


@pytest.mark.parametrize(
    ("size", "ratio", "seed"), [(0, 0.0, 0), (1, 0.0, 0), (300_000, 0.01, 1), (300_000, 0.05, 2)]
)
@pytest.mark.usefixtures("quick_timers")
def test_librecube_gets_a_file_byte_by_byte(librecube, folder, tmp_path, size, ratio, seed):
    data = content(size)
    (folder / "down.bin").write_bytes(data)
    (tmp_path / "ground").mkdir()
    entity = FileEntity(folder)
    _, link = librecube(tmp_path / "ground")
    keep = lossy(np.random.default_rng(seed), ratio)
    number = entity.send(folder / "down.bin", remove=True)
    ended = run(entity, link, keep)
    assert ended == [(number, True, "down.bin")]
    assert number > 1 << 32, "it answers with the lowest octet alone"
    assert (tmp_path / "ground" / "down.bin").read_bytes() == data
    assert not (folder / "down.bin").exists(), "it was to be removed"


@pytest.mark.parametrize(("ratio", "seed"), [(0.01, 1), (0.01, 2), (0.05, 3), (0.2, 4)])
@pytest.mark.usefixtures("quick_timers")
def test_librecube_sends_a_file_byte_by_byte(librecube, folder, tmp_path, ratio, seed):
    data = content(300_000)
    (tmp_path / "ground").mkdir()
    (tmp_path / "ground" / "up.bin").write_bytes(data)
    entity = FileEntity(folder)
    ground, link = librecube(tmp_path / "ground")
    keep = lossy(np.random.default_rng(seed), ratio)
    ground.put(
        destination_id=DAEMON,
        source_filename="/up.bin",
        destination_filename="up.bin",
        transmission_mode=0,
    )
    assert run(entity, link, keep) == [(0, True, "up.bin")]
    assert (folder / "up.bin").read_bytes() == data


def run(entity: FileEntity, link, keep) -> list[tuple[int, bool, str]]:
    """Carry units both ways until the daemon's end says that all is over."""
    ended: list[tuple[int, bool, str]] = []
    for now_ns in iter(time.monotonic_ns, None):
        for unit in keep(entity.poll(now_ns)):
            link.indication(unit)
        sent, link.sent[:] = list(link.sent), []
        for unit in keep(sent):
            entity.receive(unit, now_ns)
        ended += entity.finished()
        if ended and not link.sent and not entity.poll(now_ns):
            return ended
        time.sleep(0.001)  # its threads work
    raise AssertionError


@pytest.mark.usefixtures("quick_timers")
@pytest.mark.parametrize("seed", range(6))
def test_two_such_ends_agree_whatever_is_lost(tmp_path, seed):
    rng = np.random.default_rng(seed)
    keep = lossy(rng, (0.01, 0.1, 0.4)[seed % 3])
    folders = [tmp_path / "daemon", tmp_path / "ground"]
    for place in folders:
        place.mkdir()
    daemon = FileEntity(folders[0])
    ground = FileEntity(folders[1], ends=Pair(here=GROUND, there=DAEMON))
    sizes = rng.integers(1, 40_000, 4)
    for k, size in enumerate(sizes):
        (folders[k % 2] / f"file{k}").write_bytes(content(int(size), seed))
        (daemon, ground)[k % 2].send(folders[k % 2] / f"file{k}", remove=False)
    ended = {daemon: [], ground: []}
    for now_ns in iter(time.monotonic_ns, None):
        for unit in keep(daemon.poll(now_ns)):
            ground.receive(unit, now_ns)
        for unit in keep(ground.poll(now_ns)):
            daemon.receive(unit, now_ns)
        for entity in ended:
            ended[entity] += entity.finished()
        if sum(map(len, ended.values())) == 2 * len(sizes):
            break
        time.sleep(0.0002)  # the library's timers are the machine's
    assert [text for found in ended.values() for _, good, text in found if not good] == []
    for k in range(len(sizes)):
        assert filecmp.cmp(folders[0] / f"file{k}", folders[1] / f"file{k}", shallow=False)


FUZZ_SEEDS = range(4)


@pytest.mark.parametrize("seed", FUZZ_SEEDS)
def test_spoiled_units_never_raise_and_leave_nothing_outside(folder, tmp_path, seed):
    rng = np.random.default_rng(seed)
    entity = FileEntity(folder, max_file_bytes=1 << 16)
    (folder / "a").write_bytes(content(3000))
    for step in range(1500):
        up = Uplink(content(600, step), f"up{step % 3}", number=step // 30)
        units = [up.metadata(), up.data(0, 300), up.data(300), up.end()]
        if step % 700 == 0:
            entity.send(folder / "a", remove=False)
        units += entity.poll(step * S // 10)
        unit = bytearray(units[rng.integers(len(units))])
        for _ in range(rng.integers(0, 4)):
            unit[rng.integers(len(unit))] = rng.integers(256)
        entity.receive(
            bytes(unit[: rng.integers(1, len(unit) + 1)]) if step % 5 == 0 else bytes(unit),
            step * S // 10,
        )
        entity.finished()
    assert {path.name for path in tmp_path.iterdir()} == {"files"}
    assert sum(path.stat().st_size for path in folder.iterdir()) < 1 << 20
    good = Uplink(content(500, 99), "good", number=60_000)
    later = 10_000 * S
    drain(entity, later)
    for unit in (good.metadata(), good.data(), good.end()):
        entity.receive(unit, later)
    assert (folder / "good").read_bytes() == good.content
