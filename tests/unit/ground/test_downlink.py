"""Authenticated telemetry: sealed by the daemon's side, opened by the ground's own reader."""

import pytest
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes
from spacepackets.uslp.header import PrimaryHeader

from fsw.telemetry.link.sdls import Association, Role
from fsw.telemetry.link.sdls_numbers import NumberStore
from fsw.telemetry.link.sdls_sender import AHEAD, OVERHEAD_BYTES, FrameSender
from ground.downlink import FrameStream
from tests.support.fake_daemon import packet
from tests.support.keys import write_key
from tests.support.sdls_sender import with_fecf

KEY, OTHER = bytes(range(50, 82)), bytes(range(60, 92))
HEALTH = packet("health", mode=3)


class Sealing(FrameSender):
    """A sender of a folder; its events are kept."""

    def __init__(self, folder, key=KEY, spi=2, **options) -> None:
        self.events: list[str] = []
        folder.mkdir(exist_ok=True)
        super().__init__(
            Association(spi=spi, key=key, role=Role.TELEMETRY),
            NumberStore(folder / "numbers.json"),
            **{"spacecraft_id": 42, "virtual_channel": 3} | options,
            report=lambda code, _text: self.events.append(code),
            unix_s=lambda: 0.0,
        )


@pytest.fixture
def key_file(tmp_path):
    return write_key(tmp_path / "tm.key", KEY)


def reader(key_file, **options) -> FrameStream:
    values = {"spi": 2, "spacecraft_id": 42, "virtual_channel": 3} | options
    return FrameStream(key_file, key_file.parent / "state", **values)


def opened(stream: FrameStream, data: bytes) -> list[bytes]:
    stream.add(data)
    return list(stream.packets())


def test_telemetry_of_another_robot_cannot_be_readdressed(key_file, tmp_path):
    frame = Sealing(tmp_path / "board", spacecraft_id=43).seal(HEALTH)
    first = int.from_bytes(frame[:4], "big") & ~0x0FFFF000 | 42 << 12
    changed = with_fecf(first.to_bytes(4, "big") + frame[4:-2])
    stream = reader(key_file)
    assert opened(stream, changed) == []
    assert stream.rejected == 1
    theirs = reader(key_file, spacecraft_id=43)
    assert opened(theirs, frame) == [HEALTH]


@pytest.mark.parametrize("names", [True, False])
def test_both_ends_agree_on_the_mask(key_file, tmp_path, names: bool):
    frame = Sealing(tmp_path / "board", names_spacecraft=names).seal(HEALTH)
    assert opened(reader(key_file, names_spacecraft=names), frame) == [HEALTH]
    assert opened(reader(key_file, names_spacecraft=not names), frame) == []


def test_packets_come_through_wherever_the_stream_is_cut(key_file, tmp_path):
    sender, stream = Sealing(tmp_path / "board"), reader(key_file)
    packets = [packet("health", mode=k) + bytes(50 * k) for k in range(20)]
    data = b"".join(map(sender.seal, packets))
    found = [item for at in range(0, len(data), 37) for item in opened(stream, data[at : at + 37])]
    assert found == packets
    assert (stream.rejected, stream.skipped_bytes) == (0, 0)


@pytest.mark.parametrize(("names", "spacecraft"), [(True, 42), (False, 0)])
def test_the_frame_is_the_one_of_the_standards(tmp_path, names: bool, spacecraft: int):
    frame = Sealing(tmp_path / "board", names_spacecraft=names).seal(HEALTH)
    header = PrimaryHeader.unpack(frame)
    assert (header.scid, header.vcid, header.map_id) == (42, 3, 0)
    assert header.frame_len == len(frame) - 1 == len(HEALTH) + OVERHEAD_BYTES - 1
    spi, iv = frame[7:9], frame[9:21]
    # 4 bits version, 16 bits spacecraft, 1 bit source, 6 bits channel, 4 bits MAP, 1 bit
    aad = (spacecraft << 12 | 3 << 5).to_bytes(4, "big") + bytes(3) + spi + bytes(12)
    cipher = Cipher(algorithms.AES(KEY), modes.GCM(iv, frame[-18:-2])).decryptor()
    cipher.authenticate_additional_data(aad)
    assert cipher.update(frame[21:-18]) + cipher.finalize() == b"\xe0" + HEALTH
    assert with_fecf(frame[:-2]) == frame


def test_no_changed_bit_and_no_foreign_frame_gets_through(key_file, tmp_path):
    frame, spoilt = Sealing(tmp_path / "board").seal(packet("alive")), reader(key_file)
    for at in range(8 * (len(frame) - 2)):
        changed = bytearray(frame[:-2])
        changed[at // 8] ^= 1 << at % 8
        assert opened(spoilt, with_fecf(bytes(changed)) + bytes(70000)) == []
    assert opened(spoilt, frame) == [packet("alive")]
    for sender in (Sealing(tmp_path / "b", OTHER), Sealing(tmp_path / "c", spi=3)):
        stream = reader(key_file)
        assert opened(stream, sender.seal(HEALTH)) == []
        assert stream.rejected == 1
    assert opened(reader(key_file), HEALTH) == [], "in clear: discarded"


def test_a_recorded_frame_is_not_believed_again_also_not_by_a_later_run(key_file, tmp_path):
    sender = Sealing(tmp_path / "board")
    frames = [sender.seal(HEALTH) for _ in range(3)]
    first = reader(key_file)
    assert opened(first, frames[0] + frames[1] + frames[0]) == [HEALTH, HEALTH]
    assert first.rejected == 1
    first.close()
    later = reader(key_file)
    assert opened(later, b"".join(frames)) == [HEALTH], "only the one that is new"
    assert later.rejected == 2


def test_numbers_rise_across_crash_and_orderly_end(key_file, tmp_path):
    stream = reader(key_file)
    for run in range(4):
        sender = Sealing(tmp_path / "board")
        assert opened(stream, sender.seal(HEALTH) + sender.seal(HEALTH)) == [HEALTH, HEALTH]
        if run % 2:
            sender.settle()
    number = int.from_bytes(Sealing(tmp_path / "board").seal(HEALTH)[9:15], "big")
    assert 2 * AHEAD < number < 2 * AHEAD + 10, "two crashes, two orderly ends"


def test_telemetry_goes_on_when_its_numbers_cannot_be_kept(key_file, tmp_path, monkeypatch):
    sender = Sealing(tmp_path / "board")

    def full(*_arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    frames = [sender.seal(HEALTH) for _ in range(3)]
    monkeypatch.undo()
    assert sender.events == ["TM_NUMBERS_FAILED"]
    assert opened(reader(key_file), b"".join(frames)) == [HEALTH] * 3


def test_a_key_that_was_changed_on_board_is_read_again_on_the_ground(key_file, tmp_path):
    sender, stream = Sealing(tmp_path / "board"), reader(key_file)
    assert opened(stream, sender.seal(HEALTH)) == [HEALTH]
    sender.use(Association(spi=2, key=OTHER, role=Role.TELEMETRY))
    assert opened(stream, sender.seal(HEALTH)) == []
    write_key(tmp_path / "tm.key", OTHER)
    assert opened(stream, sender.seal(HEALTH)) == [HEALTH]
    (tmp_path / "tm.key").unlink()
    assert opened(stream, sender.seal(HEALTH)) == [HEALTH], "the file is needed no more"
