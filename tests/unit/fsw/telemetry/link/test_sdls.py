"""The authenticated uplink against a sender written from the standard."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spacepackets.ecss import PusTc

from fsw.telemetry.link.sdls import (
    MAX_BYTES,
    RESERVE,
    Accepted,
    Association,
    FrameReceiver,
    FrameReject,
    FrameSplitter,
    Rejected,
)
from fsw.telemetry.link.sdls_numbers import NumberStore
from tests.support.sdls_sender import Sender, with_fecf

KEY, NEW_KEY = bytes(range(32)), bytes(range(100, 132))
PING = bytes(PusTc(service=17, message_subtype=1, apid=100, seq_count=5).pack())
WINDOW = 64


def receiver(path, keys=((7, KEY),)) -> FrameReceiver:
    return FrameReceiver(
        [Association(spi=spi, key=key) for spi, key in keys],
        NumberStore(path / "numbers.json"),
        spacecraft_id=42,
        virtual_channel=3,
        window=WINDOW,
    )


@pytest.fixture
def uplink(tmp_path) -> FrameReceiver:
    return receiver(tmp_path)


@pytest.fixture
def sender() -> Sender:
    return Sender(key=KEY)


def reason(outcome: Accepted | Rejected) -> FrameReject | None:
    return outcome.reason if isinstance(outcome, Rejected) else None


def test_a_frame_of_the_standard_gives_its_packet(uplink, sender):
    assert uplink.receive(sender.frame(PING, 0)) == Accepted(packet=PING, spi=7, number=0)
    assert uplink.accepted == 1


def test_the_packet_is_not_readable_on_the_way(sender):
    assert PING not in sender.frame(PING, 0)


@pytest.mark.parametrize("length", [1, 13, 986, 987])
def test_every_length_up_to_the_longest_frame_passes(uplink, sender, length):
    packet = np.random.default_rng(1).bytes(length)
    frame = sender.frame(packet, 0)
    assert len(frame) <= MAX_BYTES
    assert uplink.receive(frame) == Accepted(packet=packet, spi=7, number=0)


def test_a_frame_is_taken_once(uplink, sender):
    frame = sender.frame(PING, 0)
    uplink.receive(frame)
    again = uplink.receive(frame)
    assert reason(again) is FrameReject.REPLAY
    assert isinstance(again, Rejected)
    assert (again.packet, again.next_number) == (PING, 1)
    assert uplink.accepted == 1


def test_the_window_is_strictly_forward(uplink, sender):
    assert reason(uplink.receive(sender.frame(PING, 10))) is None
    for number in (0, 9, 10, 11 + WINDOW, 1 << 47):
        assert reason(uplink.receive(sender.frame(PING, number))) is FrameReject.REPLAY
    assert reason(uplink.receive(sender.frame(PING, 10 + WINDOW))) is None
    assert reason(uplink.receive(sender.frame(PING, 11))) is FrameReject.REPLAY
    assert uplink.rejected == Counter({FrameReject.REPLAY: 6})


def test_a_forged_number_does_not_move_the_window(uplink, sender):
    uplink.receive(Sender(key=NEW_KEY).frame(PING, 50))
    assert reason(uplink.receive(sender.frame(PING, 0))) is None


def test_every_tampered_bit_is_rejected_with_and_without_its_checksum(tmp_path, sender):
    frame = sender.frame(PING, 3)
    uplink = receiver(tmp_path)
    for at in range(8 * len(frame)):
        spoiled = bytearray(frame)
        spoiled[at // 8] ^= 1 << at % 8
        assert reason(uplink.receive(bytes(spoiled))) is FrameReject.BAD_CRC
        if at // 8 < len(frame) - 2:
            resealed = with_fecf(bytes(spoiled[:-2]))
            assert reason(uplink.receive(resealed)) is FrameReject.NOT_AUTHENTICATED
    assert uplink.accepted == 0
    assert sum(uplink.rejected.values()) == 8 * len(frame) + 8 * (len(frame) - 2)
    assert reason(uplink.receive(frame)) is None


@pytest.mark.parametrize(
    "change",
    [
        {"key": NEW_KEY},
        {"spi": 8},
        {"spacecraft_id": 43},
        {"standard_mask": True},
        {"virtual_channel": 2},
        {"version": 1},
        {"bypass": 0},
        {"control": 1},
        {"spare": 1},
        {"sequence": 1},
    ],
    ids=str,
)
def test_a_sender_that_differs_in_one_thing_is_not_authentic(uplink, sender, change):
    frame = replace(sender, **change).frame(PING, 0)
    assert reason(uplink.receive(frame)) is FrameReject.NOT_AUTHENTICATED
    assert uplink.next_number(7) == 0


def readdressed(frame: bytes, spacecraft_id: int) -> bytes:
    """Return a frame with another spacecraft id, as somebody without the key can make it."""
    first = int.from_bytes(frame[:2], "big") & ~0x3FF | spacecraft_id
    return with_fecf(first.to_bytes(2, "big") + frame[2:-2])


def test_a_frame_for_another_robot_cannot_be_readdressed(uplink):
    frame = Sender(key=KEY, spacecraft_id=43).frame(PING, 0)
    outcome = uplink.receive(readdressed(frame, 42))
    assert reason(outcome) is FrameReject.NOT_AUTHENTICATED


def test_the_standards_mask_can_be_chosen(tmp_path):
    uplink = FrameReceiver(
        [Association(spi=7, key=KEY)],
        NumberStore(tmp_path / "numbers.json"),
        spacecraft_id=42,
        virtual_channel=3,
        window=WINDOW,
        names_spacecraft=False,
    )
    frame = Sender(key=KEY, standard_mask=True).frame(PING, 0)
    assert reason(uplink.receive(frame)) is None
    assert reason(uplink.receive(Sender(key=KEY).frame(PING, 1))) is not None


@pytest.mark.parametrize("length", [0, 4, 5, 37, 1025])
def test_a_frame_of_impossible_length_is_rejected(uplink, length):
    assert reason(uplink.receive(bytes(length))) is FrameReject.BAD_LENGTH


def test_two_keys_take_turns_and_keep_their_own_numbers(tmp_path):
    uplink = receiver(tmp_path, ((7, KEY), (8, NEW_KEY)))
    old, new = Sender(key=KEY, spi=7), Sender(key=NEW_KEY, spi=8)
    assert reason(uplink.receive(old.frame(PING, 40))) is None
    assert reason(uplink.receive(new.frame(PING, 0))) is None
    assert reason(uplink.receive(old.frame(PING, 41))) is None
    assert (uplink.next_number(7), uplink.next_number(8)) == (42, 1)


def test_a_retired_key_stays_retired(tmp_path):
    keys = ((7, KEY), (8, NEW_KEY))
    store = NumberStore(tmp_path / "numbers.json")
    store.retire(Association(spi=7, key=KEY).fingerprint)
    uplink = receiver(tmp_path, keys)
    outcome = uplink.receive(Sender(key=KEY, spi=7).frame(PING, 0))
    assert reason(outcome) is FrameReject.NOT_AUTHENTICATED
    assert uplink.next_number(7) is None
    assert reason(uplink.receive(Sender(key=NEW_KEY, spi=8).frame(PING, 0))) is None


def test_a_key_that_comes_back_does_not_start_again(tmp_path, sender):
    receiver(tmp_path).receive(sender.frame(PING, 5))
    receiver(tmp_path, ((7, NEW_KEY),)).receive(Sender(key=NEW_KEY).frame(PING, 0))
    back = receiver(tmp_path, ((9, KEY),))
    assert reason(back.receive(replace(sender, spi=9).frame(PING, 5))) is FrameReject.REPLAY


@pytest.mark.parametrize("seed", range(20))
def test_a_stream_with_rubbish_gives_every_frame_wherever_it_is_cut(tmp_path, sender, seed):
    rng = np.random.default_rng(seed)
    uplink = receiver(tmp_path)
    splitter = FrameSplitter(uplink)
    stream = b""
    for number in range(12):
        rubbish = rng.bytes(rng.integers(0, 60))
        looks_like_a_frame = sender.frame(PING, 0)[:5] if number % 3 == 0 else b""
        stream += rubbish + looks_like_a_frame + sender.frame(PING, number)
    stream += bytes(MAX_BYTES)
    outcomes = []
    while stream:
        size = int(rng.integers(1, 80))
        outcomes += splitter.feed(stream[:size])
        stream = stream[size:]
    assert [item.number for item in outcomes if isinstance(item, Accepted)] == list(range(12))


def test_what_only_looks_like_a_frame_does_not_hold_up_the_next_for_long(uplink, sender):
    splitter = FrameSplitter(uplink)
    longer = sender.frame(20 * PING, 0)[:5]
    assert splitter.feed(longer + sender.frame(PING, 1), 0) == []
    assert splitter.expire(499_999_999) == []
    outcomes = splitter.expire(500_000_000)
    assert [item.number for item in outcomes if isinstance(item, Accepted)] == [1]
    assert (splitter.skipped_bytes, splitter.resyncs) == (5, 1)


def test_a_telecommand_in_clear_is_refused_whole(uplink, sender):
    splitter = FrameSplitter(uplink)
    outcomes = splitter.feed(PING + sender.frame(PING, 0))
    assert [reason(item) for item in outcomes] == [FrameReject.NOT_AUTHENTICATED, None]
    assert outcomes[0].packet == PING
    assert splitter.skipped_bytes == 0


@given(st.binary(max_size=3000), st.integers(1, 3000))
def test_arbitrary_bytes_never_raise_and_never_pass(tmp_path_factory, data, size):
    uplink = receiver(tmp_path_factory.mktemp("numbers"))
    splitter = FrameSplitter(uplink)
    for at in range(0, len(data), size):
        splitter.feed(data[at : at + size])
        assert len(splitter._buffer) <= MAX_BYTES
    assert uplink.accepted == 0


def test_a_sender_that_counts_the_whole_iv_is_accepted_in_order(tmp_path, sender):
    """Yamcs: the IV is one counter of 96 bits, without a random half."""
    uplink = receiver(tmp_path)
    for count in range(200):
        assert reason(uplink.receive(sender.frame(PING, 0, count))) is None
    for old in (0, 150, 199):
        assert reason(uplink.receive(sender.frame(PING, 0, old))) is FrameReject.REPLAY
    crashed = receiver(tmp_path)
    outcomes = [crashed.receive(sender.frame(PING, 0, 200 + k)) for k in range(RESERVE + 1)]
    accepted = [isinstance(outcome, Accepted) for outcome in outcomes]
    assert accepted[-1], "a crash skips at most so many"
    assert accepted == sorted(accepted)
    for old in range(200):
        assert reason(crashed.receive(sender.frame(PING, 0, old))) is FrameReject.REPLAY


@given(st.lists(st.tuples(st.integers(0, 200), st.integers(0, (1 << 48) - 1)), max_size=30))
def test_no_iv_is_accepted_below_one_that_was(tmp_path_factory, ivs):
    uplink, sender = receiver(tmp_path_factory.mktemp("numbers")), Sender(key=KEY)
    highest = -1
    for number, random in ivs:
        iv = number << 48 | random
        if isinstance(uplink.receive(sender.frame(PING, number, random)), Accepted):
            assert iv > highest
            assert number < (max(highest, 0) >> 48) + 1 + WINDOW
            highest = iv
