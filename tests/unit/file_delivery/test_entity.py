"""File delivery against LibreCube's implementation, over links that lose, and under fire."""

import filecmp
import gc
import io
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from spacepackets.cfdp import (
    ChecksumType,
    ConditionCode,
    Direction,
    PduConfig,
    TransmissionMode,
)
from spacepackets.cfdp.pdu import (
    AckPdu,
    DirectiveType,
    EofPdu,
    FileDataPdu,
    FinishedPdu,
    MetadataParams,
    MetadataPdu,
    NakPdu,
)
from spacepackets.cfdp.pdu.file_data import FileDataParams
from spacepackets.cfdp.pdu.helper import PduFactory
from spacepackets.util import ByteFieldU8, ByteFieldU16, ByteFieldU64

from file_delivery import incoming, library
from file_delivery.entity import FileEntity
from file_delivery.errors import DeliveryError
from file_delivery.library import DAEMON, GROUND, Pair
from file_delivery.paths import confined
from file_delivery.units import UnitError, parse

S = 1_000_000_000
CANCELS = (ConditionCode.CANCEL_REQUEST_RECEIVED, ConditionCode.FILE_CHECKSUM_FAILURE)


@pytest.fixture
def folder(tmp_path) -> Path:
    path = tmp_path / "files"
    path.mkdir()
    return path


@pytest.fixture
def entity(folder) -> FileEntity:
    return FileEntity(folder, max_file_bytes=1 << 20)


class Uplink:
    """Units of one file as a ground would send them, made by hand."""

    def __init__(self, content: bytes, name: str = "up.bin", number: int = 7) -> None:
        self.content, self.name, self.number = content, name, number
        self.checksum_type = ChecksumType.CRC_32
        self.checksum = zlib.crc32(content).to_bytes(4, "big")
        self.source, self.size = GROUND, len(content)
        self.mode = TransmissionMode.ACKNOWLEDGED

    @property
    def conf(self) -> PduConfig:
        return PduConfig(
            source_entity_id=ByteFieldU8(self.source),
            dest_entity_id=ByteFieldU8(DAEMON),
            transaction_seq_num=ByteFieldU16(self.number),
            trans_mode=self.mode,
        )

    def metadata(self) -> bytes:
        params = MetadataParams(
            closure_requested=True,
            checksum_type=self.checksum_type,
            file_size=self.size,
            source_file_name="anything",
            dest_file_name=self.name,
        )
        return bytes(MetadataPdu(self.conf, params).pack())

    def data(self, start: int = 0, end: int | None = None) -> bytes:
        piece = self.content[start:end]
        return bytes(FileDataPdu(self.conf, FileDataParams(piece, start)).pack())

    def end(self) -> bytes:
        return bytes(EofPdu(self.conf, self.checksum, self.size).pack())


def drain(entity: FileEntity, now_ns: int = 0) -> list[bytes]:
    found: list[bytes] = []
    while units := entity.poll(now_ns):
        found += units
    return found


def content(size: int, seed: int = 1) -> bytes:
    return np.random.default_rng(seed).bytes(size)


def leftovers(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*"))


# --- up


def test_a_file_comes_up_whole(entity, folder):
    up = Uplink(content(700))
    for unit in (up.metadata(), up.data(0, 300), up.data(300), up.end()):
        entity.receive(unit, 0)
    assert (folder / "up.bin").read_bytes() == up.content
    assert entity.finished() == [(0, True, "up.bin")]
    assert entity.counters()["files_received"] == 1


def test_until_it_is_whole_the_old_file_stays(entity, folder):
    (folder / "up.bin").write_bytes(b"old")
    up = Uplink(content(700))
    for unit in (up.metadata(), up.data(0, 300)):
        entity.receive(unit, 0)
    assert (folder / "up.bin").read_bytes() == b"old"
    entity.receive(up.data(300), 0)
    entity.receive(up.end(), 0)
    assert (folder / "up.bin").read_bytes() == up.content


@pytest.mark.parametrize("kind", [ChecksumType.CRC_32, ChecksumType.MODULAR])
def test_a_wrong_checksum_leaves_the_old_file(entity, folder, kind):
    (folder / "up.bin").write_bytes(b"old")
    up = Uplink(content(700))
    up.checksum_type, up.checksum = kind, b"\x12\x34\x56\x78"
    for unit in (up.metadata(), up.data(), up.end()):
        entity.receive(unit, 0)
    assert (folder / "up.bin").read_bytes() == b"old"
    assert entity.finished() == [(0, False, "up.bin: FILE_CHECKSUM_FAILURE")]
    assert leftovers(folder) == ["up.bin"]


@pytest.mark.parametrize(
    "name",
    ["", "/etc/passwd", "../up.bin", "a/../../up.bin", ".hidden", "a/.b", "link/up.bin", "x\0y"],
)
def test_no_name_leads_out_of_the_directory(folder, tmp_path, name):
    (tmp_path / "elsewhere").mkdir()
    (folder / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(DeliveryError):
        confined(folder, name)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("../up.bin", "no name below"),
        ("/tmp/up.bin", "no name below"),
        ("missing/up.bin", "no such folder"),
        ("sub", "a folder itself"),
        ("loop/up.bin", "loop"),
    ],
)
def test_a_refused_name_is_reported_at_once_with_its_reason(entity, folder, tmp_path, name, why):
    (folder / "sub").mkdir()
    (folder / "loop").symlink_to(folder / "loop")
    up = Uplink(content(100), name)
    entity.receive(up.metadata(), 0)
    (ended,) = entity.finished()
    assert not ended[1]
    assert why in ended[2]
    told = [u for u in map(PduFactory.from_raw, drain(entity)) if isinstance(u, FinishedPdu)]
    assert [u.condition_code for u in told] == [ConditionCode.FILESTORE_REJECTION]
    assert why.encode() in told[0].file_store_responses[0].filestore_msg.value
    entity.receive(up.end(), 0)
    again = [type(u) for u in map(PduFactory.from_raw, drain(entity))]
    assert again == [AckPdu, FinishedPdu], "should the first have been lost"
    assert leftovers(tmp_path) == ["files", "loop", "sub"]


def test_a_refused_file_blocks_nobody(entity, folder):
    refused, good = Uplink(content(9), "no/where"), Uplink(content(99, 2), "good", number=8)
    for unit in (refused.metadata(), good.metadata(), refused.data(), good.data(), good.end()):
        entity.receive(unit, 0)
    assert (folder / "good").read_bytes() == good.content


def test_several_files_come_up_at_a_time(entity, folder):
    ups = [Uplink(content(600, k), f"up{k}", number=k) for k in range(8)]
    for step in ("metadata", "data", "end"):
        for up in ups:
            entity.receive(getattr(up, step)(), 0)
    assert [(folder / up.name).read_bytes() for up in ups] == [up.content for up in ups]


def test_a_silent_transfer_gives_its_place_to_another_and_no_sooner(entity, folder):
    for k in range(8):
        entity.receive(Uplink(content(600), f"up{k}", number=k).metadata(), 0)
    late = Uplink(content(5), "late", number=8)
    entity.receive(late.metadata(), S)
    assert entity.finished() == [(0, False, "unnamed: 8 files are on their way")], (
        "all of them may still be at work"
    )
    for now_s in range(1, 7):
        entity.poll(now_s * S)
    late.number = 9
    for unit in (late.metadata(), late.data(), late.end()):
        entity.receive(unit, 7 * S)
    assert (folder / "late").read_bytes() == late.content


def test_a_number_is_used_again_by_a_ground_that_restarts(entity, folder):
    """A third-party sender may count from 1 in every run."""
    for k in range(3):
        up = Uplink(content(50, k), f"up{k}", number=1)
        for unit in (up.metadata(), up.data(), up.end()):
            entity.receive(unit, 2 * k * S)
        drain(entity, 2 * k * S)
        assert (folder / up.name).read_bytes() == up.content


def test_a_transfer_that_goes_silent_is_given_up(entity, folder):
    up = Uplink(content(700))
    entity.receive(up.metadata(), 0)
    entity.receive(up.data(0, 300), 0)
    for now_s in range(60):
        drain(entity, now_s * S)
    assert entity.finished() == []
    drain(entity, 60 * S + 1)
    assert entity.finished() == [(0, False, "up.bin: nothing came for 60 s")]
    assert leftovers(folder) == []


def test_the_next_file_comes_up_after_one_was_given_up_with_holes(entity, folder):
    """The library keeps lost segments of one transaction for the next."""
    up = Uplink(content(700))
    entity.receive(up.metadata(), 0)
    entity.receive(up.data(500, 600), 0)
    for now_s in range(62):
        drain(entity, now_s * S)
    assert entity.finished() == [(0, False, "up.bin: nothing came for 60 s")]
    good = Uplink(content(200, 2), "next.bin", number=8)
    for unit in (good.metadata(), good.data(), good.end()):
        entity.receive(unit, 62 * S)
    assert entity.finished() == [(0, True, "next.bin")]
    assert (folder / "next.bin").read_bytes() == good.content


def test_an_end_that_is_told_again_is_acknowledged_again(entity):
    up = Uplink(content(700))
    entity.receive(up.metadata(), 0)
    entity.receive(up.end(), 0)
    first = drain(entity)
    entity.receive(up.end(), 0)
    assert [unit for unit in drain(entity) if unit in first], "the same acknowledgement"


def test_an_end_told_after_all_is_over_changes_nothing(entity, folder):
    up = Uplink(content(50))
    for unit in (up.metadata(), up.data(), up.end()):
        entity.receive(unit, 0)
    other = Uplink(content(60), "b.bin", number=9)
    for unit in (other.metadata(), other.data(), other.end()):
        entity.receive(unit, 0)
    drain(entity)
    entity.finished()
    entity.receive(up.end(), 0)
    assert len(drain(entity)) >= 1, "it is acknowledged"
    assert entity.finished() == []
    assert (folder / "up.bin").read_bytes() == up.content


@pytest.mark.parametrize("change", ["far", "stranger"])
def test_what_cannot_be_meant_is_counted_and_not_answered(entity, folder, change):
    up = Uplink(content(100))
    if change == "far":
        unit = bytes(FileDataPdu(up.conf, FileDataParams(b"x", (1 << 32) - 2)).pack())
    else:
        up.source = 77
        unit = up.metadata()
    entity.receive(unit, 0)
    assert entity.counters()["pdus_rejected"] == 1
    assert drain(entity) == []
    assert leftovers(folder) == []


@pytest.mark.parametrize(
    ("change", "condition"),
    [
        ("size", ConditionCode.FILE_SIZE_ERROR),
        ("class 1", ConditionCode.INVALID_TRANSMISSION_MODE),
        ("disk", ConditionCode.FILESTORE_REJECTION),
    ],
)
def test_what_is_beyond_the_limits_is_refused(entity, folder, monkeypatch, change, condition):
    up = Uplink(content(100))
    if change == "size":
        up.size = (1 << 20) + 1
    elif change == "disk":
        room = SimpleNamespace(free=99)
        monkeypatch.setattr("shutil.disk_usage", lambda _path: room)
    else:
        up.mode = TransmissionMode.UNACKNOWLEDGED
    for unit in (up.metadata(), up.data(), up.end()):
        entity.receive(unit, 0)
    told = [u for u in map(PduFactory.from_raw, drain(entity)) if isinstance(u, FinishedPdu)]
    assert {u.condition_code for u in told} == {condition}
    assert leftovers(folder) == []


@pytest.mark.parametrize("condition", [ConditionCode.NO_ERROR, *CANCELS])
def test_an_end_is_read_as_it_was_written(condition):
    """The library leaves the condition in the upper half of its byte, and cannot write it then."""
    end = EofPdu(Uplink(b"").conf, bytes(4), 10, condition_code=condition)
    raw = bytes(end.pack())
    unit = parse(raw, 100)
    assert isinstance(unit, EofPdu)
    assert unit.condition_code == condition
    assert bytes(unit.pack()) == raw


def test_an_end_that_cancels_is_acknowledged_and_leaves_nothing(entity, folder):
    up = Uplink(content(700))
    entity.receive(up.metadata(), 0)
    end = EofPdu(up.conf, bytes(4), 0, condition_code=ConditionCode.CANCEL_REQUEST_RECEIVED)
    entity.receive(bytes(end.pack()), 0)
    acknowledged = [u for u in map(PduFactory.from_raw, drain(entity)) if isinstance(u, AckPdu)]
    assert [u.condition_code_of_acked_pdu for u in acknowledged] == [end.condition_code]
    assert leftovers(folder) == []


def test_a_directive_with_bytes_behind_its_fields_is_refused():
    ack = bytes(AckPdu(Uplink(b"").conf, DirectiveType.EOF_PDU, 0, 1).pack())
    assert isinstance(parse(ack, 100), AckPdu)
    longer = int.from_bytes(ack[1:3], "big") + 4
    with pytest.raises(UnitError, match="announced"):
        parse(ack[:1] + longer.to_bytes(2, "big") + ack[3:] + bytes(4), 100)


@pytest.mark.parametrize("behind", [1, 4, 40])
def test_a_piece_of_a_file_with_bytes_behind_it_is_refused(behind):
    """The library takes all bytes behind the offset as the file's, whatever the length says."""
    params = FileDataParams(file_data=content(20), offset=8)
    raw = bytes(FileDataPdu(Uplink(b"").conf, params).pack())
    assert parse(raw, 100).file_data == content(20)
    with pytest.raises(UnitError, match="announced"):
        parse(raw + bytes(behind), 100)


# --- down


def test_a_file_that_is_not_there_is_refused(entity, folder):
    for path in (folder / "missing", folder):
        with pytest.raises(DeliveryError, match="FILE_NOT_FOUND"):
            entity.send(path, remove=False)


def test_no_more_files_wait_than_may(entity, folder):
    (folder / "a").write_bytes(b"a")
    for _ in range(8):
        entity.send(folder / "a", remove=False)
    with pytest.raises(DeliveryError, match="BUSY"):
        entity.send(folder / "a", remove=False)


def test_a_receiver_that_never_answers_is_given_up(entity, folder):
    (folder / "a").write_bytes(content(5000))
    number = entity.send(folder / "a", remove=True)
    for now_s in range(62):
        drain(entity, now_s * S)
    assert entity.finished() == [(number, False, "a: no answer for 60 s")]
    assert (folder / "a").exists()


@pytest.mark.parametrize(
    "requests", [[(0, 1 << 31)], [(9000, 9999)], [(0, 5000)] * 2000, [(200, 100)]]
)
def test_a_request_for_lost_data_cannot_ask_for_more_than_there_is(entity, folder, requests):
    (folder / "a").write_bytes(content(5000))
    number = entity.send(folder / "a", remove=False)
    drain(entity)
    conf = PduConfig(
        source_entity_id=ByteFieldU8(DAEMON),
        dest_entity_id=ByteFieldU8(GROUND),
        transaction_seq_num=ByteFieldU64(number),
        trans_mode=TransmissionMode.ACKNOWLEDGED,
        direction=Direction.TOWARDS_SENDER,
    )
    entity.receive(bytes(NakPdu(conf, 0, 5000, segment_requests=requests).pack()), 0)
    assert sum(map(len, drain(entity))) <= (1 << 20) * 1.1


# --- several at a time, cancelled, suspended, resumed


def pair(tmp_path: Path) -> tuple[FileEntity, FileEntity]:
    for name in ("daemon", "ground"):
        (tmp_path / name).mkdir(exist_ok=True)
    ends = Pair(here=GROUND, there=DAEMON)
    return FileEntity(tmp_path / "daemon"), FileEntity(tmp_path / "ground", ends=ends)


def carry(daemon: FileEntity, ground: FileEntity, now_ns: int = 0) -> None:
    """Carry units both ways until both are silent."""
    while True:
        down, up = daemon.poll(now_ns), ground.poll(now_ns)
        for unit in down:
            ground.receive(unit, now_ns)
        for unit in up:
            daemon.receive(unit, now_ns)
        if not down and not up:
            return


def test_a_file_waits_for_no_silent_receiver(tmp_path):
    """An interrupted get leaves a transfer behind; the next one must not wait for its time-out."""
    daemon, ground = pair(tmp_path)
    for k in range(5):
        (tmp_path / "daemon" / f"f{k}").write_bytes(content(5000, k))
        daemon.send(tmp_path / "daemon" / f"f{k}", remove=False)
    drain(daemon)  # four are sent into nowhere: their receiver is gone
    for now_ns in range(0, 6 * S + 1, S // 2):
        drain(daemon, now_ns) if now_ns < 5 * S else carry(daemon, ground, now_ns)
    assert (tmp_path / "ground" / "f4").read_bytes() == content(5000, 4)


@pytest.mark.parametrize("canceller", ["sender", "receiver"])
def test_a_cancelled_transfer_ends_at_both_ends(tmp_path, canceller):
    daemon, ground = pair(tmp_path)
    (tmp_path / "daemon" / "a").write_bytes(content(100_000))
    number = daemon.send(tmp_path / "daemon" / "a", remove=False)
    for unit in daemon.poll(0):
        ground.receive(unit, 0)
    (daemon if canceller == "sender" else ground).cancel((DAEMON, number))
    carry(daemon, ground)
    assert [good for _, good, _ in daemon.finished() + ground.finished()] == [False, False]
    assert daemon.transfers() == ground.transfers() == []
    assert leftovers(tmp_path / "ground") == []
    with pytest.raises(DeliveryError, match="no transfer"):
        daemon.cancel((DAEMON, number))


def test_a_file_that_waits_is_cancelled(entity, folder):
    (folder / "a").write_bytes(b"a")
    number = entity.send(folder / "a", remove=False)
    entity.cancel((DAEMON, number))
    assert drain(entity) == []
    assert entity.finished() == [(number, False, "a: cancelled")]


def test_a_suspended_transfer_rests_and_is_resumed(tmp_path):
    daemon, ground = pair(tmp_path)
    (tmp_path / "daemon" / "a").write_bytes(content(100_000))
    number = daemon.send(tmp_path / "daemon" / "a", remove=False)
    for unit in daemon.poll(0):
        ground.receive(unit, 0)
    (before,) = daemon.transfers()
    assert (before.name, before.size, before.state.value) == ("a", 100_000, "SENDING")
    assert 0 < before.done < 100_000
    daemon.suspend((DAEMON, number))
    for now_s in range(300):
        assert drain(daemon, now_s * S) == []
    (rests,) = daemon.transfers()
    assert (rests.done, rests.state.value) == (before.done, "SUSPENDED")
    daemon.resume((DAEMON, number), 300 * S)
    carry(daemon, ground, 300 * S)
    assert (tmp_path / "ground" / "a").read_bytes() == content(100_000)


def test_while_nobody_looks_no_transfer_times_out(entity):
    """The daemon looks only while somebody is connected."""
    up = Uplink(content(700))
    entity.receive(up.metadata(), 0)
    drain(entity, 0)
    drain(entity, 1000 * S)
    assert entity.finished() == []
    assert len(entity.transfers()) == 1


def test_a_piece_of_a_file_goes_down(tmp_path):
    daemon, ground = pair(tmp_path)
    data = content(50_001)
    (tmp_path / "daemon" / "a").write_bytes(data)
    daemon.send(tmp_path / "daemon" / "a", remove=False, name="piece", piece=(1234, 40_000))
    carry(daemon, ground)
    assert (tmp_path / "ground" / "piece").read_bytes() == data[1234:41_234]


def test_files_for_others_are_left_to_them(tmp_path):
    daemon, ground = pair(tmp_path)
    other = FileEntity(
        tmp_path / "other", ends=Pair(here=GROUND, there=DAEMON), accepts=lambda name: name == "b"
    )
    (tmp_path / "other").mkdir()
    (tmp_path / "daemon" / "a").write_bytes(content(50_000))
    daemon.send(tmp_path / "daemon" / "a", remove=False)
    replies: list[bytes] = []
    while units := daemon.poll(0):
        for unit in units:
            ground.receive(unit, 0)
            other.receive(unit, 0)
            replies += other.poll(0)
        for unit in ground.poll(0):
            daemon.receive(unit, 0)
    assert replies == []
    assert (tmp_path / "ground" / "a").exists()
    assert leftovers(tmp_path / "other") == []


# --- both ends, with losses


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
