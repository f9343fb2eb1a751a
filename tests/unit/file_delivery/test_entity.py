"""Files that go down, and several at a time: cancelled, suspended, resumed."""

import pytest
from spacepackets.cfdp import (
    Direction,
    PduConfig,
    TransmissionMode,
)
from spacepackets.cfdp.pdu import (
    NakPdu,
)
from spacepackets.util import ByteFieldU8, ByteFieldU64

from file_delivery.entity import FileEntity
from file_delivery.errors import DeliveryError
from file_delivery.library import DAEMON, GROUND, Pair
from tests.support.delivery_cases import S, Uplink, carry, content, drain, leftovers, pair


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
