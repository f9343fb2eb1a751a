"""A packet store on the disk: bounded, in order, whatever happened to its files."""

import io
import os
import subprocess
import sys
import time
import tracemalloc
from contextlib import suppress
from pathlib import Path

import pytest

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.link.packets import Packetizer
from fsw.telemetry.state.packet_store import MOST_SEGMENTS, PacketStore, split_packets
from tests.support.application_cases import EPOCH, SECOND
from tests.support.small_disk import BALLAST, fill, small_disk

LIMIT = 1 << 20
PACKETIZER = Packetizer()
VALUES = {field.name: 0 for field in DICTIONARY.packet("alive").fields}


def packet(t_s: float) -> bytes:
    values = {"event": 1, "occurrence": 1, "suppressed": 0, "text": f"at {t_s}"}
    return PACKETIZER.make("event_info", round(t_s * SECOND), values)


def store(folder: Path, limit: int = LIMIT) -> PacketStore:
    return PacketStore(folder, limit, lambda: EPOCH)


def found(held: PacketStore, from_s: float | None = None, to_s: float = 1e6) -> list[bytes]:
    from_ns = None if from_s is None else round(from_s * SECOND)
    return [p for p in held.packets(from_ns, round(to_s * SECOND)) if p is not None]


def test_a_full_store_loses_its_oldest_packets_and_never_exceeds_its_size(tmp_path):
    held = store(tmp_path / "s")
    packets = [packet(k) for k in range(12_000)]
    for one in packets:
        held.append(one)
        assert held.size_bytes <= LIMIT
    on_disk = sum(path.stat().st_size for path in (tmp_path / "s").iterdir())
    assert 0.9 * LIMIT < on_disk <= LIMIT
    left = found(held)
    assert left == packets[-len(left) :]
    assert len(left) * len(packets[0]) > 0.85 * LIMIT
    assert found(held, 11_990.0, 11_995.0) == packets[11_990:11_996]


def test_each_segment_that_is_full_has_been_brought_to_the_disk(tmp_path, monkeypatch):
    synced: dict[int, int] = {}

    def sync(descriptor: int) -> None:
        status = os.fstat(descriptor)
        synced[status.st_ino] = status.st_size

    monkeypatch.setattr(os, "fsync", sync)
    held = store(tmp_path)
    for k in range(3000):
        held.append(packet(k))
    *full, _newest = [path.stat() for path in sorted(tmp_path.iterdir())]
    assert len(full) > 2
    assert all(synced.get(status.st_ino) == status.st_size for status in full)


def test_many_restarts_leave_no_more_than_so_many_files(tmp_path):
    for k in range(3 * MOST_SEGMENTS):
        held = store(tmp_path)
        held.append(packet(k))
    assert len(list(tmp_path.iterdir())) <= MOST_SEGMENTS
    assert len(found(store(tmp_path))) == MOST_SEGMENTS


def test_packets_of_a_process_that_was_killed_are_there(tmp_path):
    code = f"""
import os, signal
from pathlib import Path
from tests.unit.fsw.telemetry.test_packet_store import packet, store
held = store(Path({str(tmp_path)!r}))
for k in range(200):
    held.append(packet(k))
os.kill(os.getpid(), signal.SIGKILL)
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", code], check=False, env=environment, cwd=os.getcwd())
    assert len(found(store(tmp_path))) == 200


@pytest.mark.parametrize("cut", [1, 7, 40, 141])
def test_a_segment_that_was_cut_gives_what_is_whole(tmp_path, cut: int):
    held = store(tmp_path)
    packets = [packet(k) for k in range(5)]
    for one in packets:
        held.append(one)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:-cut])
    again = store(tmp_path)
    assert found(again) == packets[:4]
    again.append(packets[4])
    assert found(again) == packets


def test_damage_costs_the_damaged_packet_or_segment_only(tmp_path):
    held = store(tmp_path)
    packets = [packet(k) for k in range(5)]
    for one in packets:
        held.append(one)
    (path,) = tmp_path.iterdir()
    data = bytearray(path.read_bytes())
    data[-len(packets[0]) - 20] ^= 0xFF  # inside the text of the fourth
    path.write_bytes(data)
    (tmp_path / "00000002.packets").write_bytes(b"no segment at all" * 9)
    (tmp_path / "00000003.packets").write_bytes(b"")
    (tmp_path / "note.txt").write_text("not ours")
    again = store(tmp_path)
    assert found(again) == packets[:3] + packets[4:]
    assert (tmp_path / "note.txt").exists()
    again.append(packet(9))
    assert b"at 9" in found(again)[-1]


def test_a_segment_removed_while_it_is_read_is_passed_over(tmp_path):
    held = store(tmp_path)
    for k in range(9000):
        held.append(packet(k))
    reading = held.packets(None, 10**15)
    assert next(reading) is not None
    for k in range(9000, 20_000):
        held.append(packet(k))
    assert sum(one is not None for one in reading) > 0


def test_arbitrary_bytes_hold_no_packets_and_raise_nothing():
    for data in (b"", b"\0" * 5, b"\xff" * 300, packet(1)[:-1], packet(1)[:20]):
        assert list(split_packets(io.BytesIO(data))) == []


def test_a_segment_that_cannot_be_read_now_is_not_lost(tmp_path, monkeypatch):
    stored = packet(1.0)
    store(tmp_path).append(stored)
    (path,) = tmp_path.iterdir()

    def fail(_path: Path) -> None:
        raise OSError("the disk does not answer")

    with monkeypatch.context() as failing:
        failing.setattr("fsw.telemetry.state.packet_store.read_segment", fail)
        assert found(store(tmp_path)) == []
    assert path.exists()
    assert found(store(tmp_path)) == [stored]


def large_packet(t_s: float, size: int = 4096) -> bytes:
    data = bytearray(packet(t_s).ljust(size, b"\0"))
    data[4:6] = (size - 7).to_bytes(2, "big")
    return bytes(data)


def test_a_large_store_starts_at_once_and_is_never_read_whole(tmp_path):
    held = store(tmp_path, 64 << 20)
    for k in range(15_700):
        held.append(large_packet(k))
    began_s = time.perf_counter()
    tracemalloc.start()
    again = store(tmp_path, 64 << 20)
    assert again.span() == held.span()
    count = sum(1 for _ in again.packets(None, 10**15))
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count > 13_000
    assert peak_bytes < 1 << 20
    later_s = time.perf_counter()
    store(tmp_path, 64 << 20)
    assert time.perf_counter() - later_s < 0.1 * (later_s - began_s), "a start reads every packet"


def test_the_reserve_of_a_disk_is_left_and_nothing_stored_is_removed_for_want_of_room(tmp_path):
    with small_disk(tmp_path / "disk", 4 << 20) as disk:
        held = PacketStore(disk / "s", 2 << 20, lambda: EPOCH, reserve_bytes=5 << 19)
        stored = []
        with suppress(OSError):
            for k in range(100_000):
                held.append(one := packet(k))
                stored.append(one)
        assert 1000 < len(stored) < 100_000
        room = os.statvfs(disk)
        assert room.f_bavail * room.f_frsize >= (5 << 19) - 4096
        fill(disk)
        for k in range(200):
            with pytest.raises(OSError, match="No space left"):
                held.append(packet(k))
        assert found(store(disk / "s", 2 << 20)) == stored
        (disk / BALLAST).unlink()
        assert held.delete_until(1000 * SECOND) > 0
        held.append(packet(5))


def test_a_segment_that_was_removed_is_followed_by_one_that_can_be_read(tmp_path):
    held = store(tmp_path)
    held.append(packet(1))
    (path,) = tmp_path.iterdir()
    path.unlink()
    with pytest.raises(OSError, match="No such file"):
        held.append(packet(2))
    held.append(packet(3))
    assert b"at 3" in found(store(tmp_path))[-1]
