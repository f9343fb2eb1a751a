"""The sending end of authenticated telecommands against a sender written from the standard."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

from ground.errors import UsageError
from ground.sdls import Sealer
from tests.support.sdls_sender import Sender

KEY = bytes(range(32))


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "uplink.key"
    path.write_bytes(KEY)
    path.chmod(0o600)
    return path


def sealer(key_file, tmp_path) -> Sealer:
    return Sealer(key_file, tmp_path / "state", spi=7, spacecraft_id=42, virtual_channel=3)


def test_frames_are_byte_by_byte_those_of_the_standard(key_file, tmp_path):
    ours, theirs = sealer(key_file, tmp_path), Sender(key=KEY)
    for number, packet in enumerate((b"a", b"telecommand", bytes(987))):
        assert ours.seal(packet) == theirs.frame(packet, number)


def test_no_number_is_used_twice_by_another_program_or_later(key_file, tmp_path):
    with ThreadPoolExecutor(4) as pool:
        makers = [sealer(key_file, tmp_path) for _ in range(4)]
        frames = list(pool.map(lambda k: makers[k % 4].seal(b"x"), range(40)))
    frames += [sealer(key_file, tmp_path).seal(b"x") for _ in range(3)]
    numbers = [int.from_bytes(frame[7:19], "big") for frame in frames]
    assert sorted(numbers) == list(range(43))


def test_it_can_be_told_where_the_daemon_is(key_file, tmp_path):
    ours = sealer(key_file, tmp_path)
    assert ours.is_behind(17)
    ours.skip_to(17)
    assert not ours.is_behind(17)
    ours.skip_to(3)
    assert ours.seal(b"x") == Sender(key=KEY).frame(b"x", 17)


def test_keys_that_others_can_read_and_packets_too_long_are_refused(key_file, tmp_path):
    with pytest.raises(UsageError, match="987"):
        sealer(key_file, tmp_path).seal(bytes(988))
    key_file.chmod(0o644)
    with pytest.raises(UsageError, match="0600"):
        sealer(key_file, tmp_path)
