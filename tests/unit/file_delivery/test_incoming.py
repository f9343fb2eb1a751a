"""Files that come up: whole or not at all, and nothing outside their folder."""

from types import SimpleNamespace

import pytest
from spacepackets.cfdp import (
    ChecksumType,
    ConditionCode,
    TransmissionMode,
)
from spacepackets.cfdp.pdu import (
    AckPdu,
    DirectiveType,
    EofPdu,
    FileDataPdu,
    FinishedPdu,
)
from spacepackets.cfdp.pdu.file_data import FileDataParams
from spacepackets.cfdp.pdu.helper import PduFactory

from file_delivery.entity import FileEntity
from file_delivery.errors import DeliveryError
from file_delivery.paths import confined
from file_delivery.units import UnitError, parse
from tests.support.delivery_cases import S, Uplink, content, drain, leftovers

CANCELS = (ConditionCode.CANCEL_REQUEST_RECEIVED, ConditionCode.FILE_CHECKSUM_FAILURE)


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
    [
        *("", "/etc/passwd", "../up.bin", "a/../../up.bin", ".hidden", "a/.b", "link/up.bin"),
        *("x\0y", "gr\u00fcn", "\x1b[2Jgone", "a\u202egpj.exe", "new\nline", "n" * 120),
    ],
)
def test_no_name_leads_out_of_the_directory(folder, tmp_path, name):
    (tmp_path / "elsewhere").mkdir()
    (folder / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(DeliveryError):
        confined(folder, name)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("../up.bin", "not a name below"),
        ("/tmp/up.bin", "not a name below"),
        ("missing/up.bin", "no such folder"),
        ("sub", "a folder itself"),
        ("loop/up.bin", "loop"),
        ("gr\u00fcn\x1b[2J\u202e", r"ASCII characters, not 'gr\xfcn\x1b[2J\u202e'"),
        ("n" * 120, "at most 89"),
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
        room = SimpleNamespace(f_bavail=99, f_frsize=1, f_files=0, f_favail=0)
        monkeypatch.setattr("os.statvfs", lambda _path: room)
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


def test_a_rest_that_cannot_be_removed_ends_the_transfer_and_nothing_else(
    entity, folder, monkeypatch
):
    up = Uplink(content(700))
    entity.receive(up.metadata(), 0)

    def fails(_path, **_options):
        raise OSError(30, "Read-only file system")

    with monkeypatch.context() as failing:
        failing.setattr("pathlib.Path.unlink", fails)
        end = EofPdu(up.conf, bytes(4), 0, condition_code=ConditionCode.CANCEL_REQUEST_RECEIVED)
        entity.receive(bytes(end.pack()), 0)
        drain(entity)
        FileEntity(folder)  # so that a start with such a rest has a link
    assert [good for _, good, _ in entity.finished()] == [False]
