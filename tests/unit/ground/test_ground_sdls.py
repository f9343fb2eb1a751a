"""The sending end of authenticated telecommands against a sender written from the standard."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from fsw.telemetry.link.sdls import Accepted, Association, FrameReceiver, Rejected
from fsw.telemetry.link.sdls_numbers import NumberStore
from ground.errors import UsageError
from ground.sdls import Sealer
from tests.support.keys import write_key
from tests.support.nonce_reuse import forge_from_one_nonce
from tests.support.sdls_sender import Sender

KEY = bytes(range(32))


@pytest.fixture
def key_file(tmp_path):
    return write_key(tmp_path / "uplink.key", KEY)


def sealer(key_file, tmp_path) -> Sealer:
    return Sealer(key_file, tmp_path / "state", spi=7, spacecraft_id=42, virtual_channel=3)


def iv_of(frame: bytes) -> tuple[int, int]:
    """Return number and random half."""
    return int.from_bytes(frame[7:13], "big"), int.from_bytes(frame[13:19], "big")


def test_frames_are_byte_by_byte_those_of_the_standard(key_file, tmp_path):
    ours, theirs = sealer(key_file, tmp_path), Sender(key=KEY)
    for count, packet in enumerate((b"a", b"telecommand", bytes(987))):
        frame = ours.seal(packet)
        number, random = iv_of(frame)
        assert number == count
        assert frame == theirs.frame(packet, number, random)


def test_no_number_is_used_twice_by_another_program_or_later(key_file, tmp_path):
    with ThreadPoolExecutor(4) as pool:
        makers = [sealer(key_file, tmp_path) for _ in range(4)]
        frames = list(pool.map(lambda k: makers[k % 4].seal(b"x"), range(40)))
    frames += [sealer(key_file, tmp_path).seal(b"x") for _ in range(3)]
    assert sorted(iv_of(frame)[0] for frame in frames) == list(range(43))


def test_lost_and_copied_state_folders_never_use_an_iv_twice(key_file, tmp_path):
    ivs = []
    for folder in range(50):
        ours = sealer(key_file, tmp_path / str(folder))
        ivs += [iv_of(ours.seal(b"x")) for _ in range(4)]
    assert {number for number, _ in ivs} == {0, 1, 2, 3}
    assert len(set(ivs)) == len(ivs)


def test_without_the_key_no_command_can_be_forged_from_two_frames_of_one_number(key_file, tmp_path):
    """Source: Joux, Authentication failures in NIST version of GCM (2006)."""
    known, unknown, wanted = b"PING seq 0001", b"PING seq 0002", b"RESTART  0003"
    frames = [
        sealer(key_file, tmp_path / name).seal(packet)
        for name, packet in (("first", known), ("second", unknown))
    ]
    forged = forge_from_one_nonce(frames[0], frames[1], known, wanted)
    receiver = FrameReceiver(
        [Association(spi=7, key=KEY)],
        NumberStore(tmp_path / "numbers.json"),
        spacecraft_id=42,
        virtual_channel=3,
        window=64,
    )
    outcome = receiver.receive(forged)  # the two that were sealed never arrived
    assert isinstance(outcome, Rejected), f"forged without the key: {outcome.packet!r}"
    assert isinstance(receiver.receive(frames[1]), Accepted)


def test_numbers_continue_where_they_are_set_higher_or_lower(key_file, tmp_path):
    ours = sealer(key_file, tmp_path)
    assert ours.is_new
    assert ours.next_number == 0
    assert ours.is_new, "to look changes nothing"
    ours.set_next(17)
    assert iv_of(ours.seal(b"x"))[0] == 17
    ours.set_next(3)
    assert (ours.next_number, ours.is_new) == (3, False)


def test_a_key_file_that_is_replaced_is_the_key_of_the_next_frame(key_file, tmp_path):
    ours = sealer(key_file, tmp_path)
    ours.seal(b"x")
    write_key(key_file, KEY[::-1])
    frame = ours.seal(b"x")
    assert frame == Sender(key=KEY[::-1]).frame(b"x", *iv_of(frame))
    assert iv_of(frame)[0] == 0, "every key has its own numbers"


def test_keys_that_others_can_read_and_packets_too_long_are_refused(key_file, tmp_path):
    with pytest.raises(UsageError, match="987"):
        sealer(key_file, tmp_path).seal(bytes(988))
    key_file.chmod(0o644)
    with pytest.raises(UsageError, match="0600"):
        sealer(key_file, tmp_path)
