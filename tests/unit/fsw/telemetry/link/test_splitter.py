"""Telecommands in clear: damage, and telecommands within telecommands."""

import pytest

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import APID_ESTIMATOR, Error
from fsw.telemetry.link.packets import telecommand_packet
from fsw.telemetry.link.splitter import PacketSplitter

KNOWN = 0x1800 | APID_ESTIMATOR
PING = telecommand_packet(DICTIONARY.telecommand("PING"), {}, 7)
RESET = telecommand_packet(DICTIONARY.telecommand("RESET_ESTIMATOR"), {}, 8)


def kept_for_later() -> bytes:
    """A telecommand that carries RESET_ESTIMATOR within it, its own bytes before it damaged."""
    body = bytes(8) + RESET
    header = PING[6:7] + bytes((11, 4)) + PING[9:11]
    packet = PING[:4] + (5 + len(body) + 1).to_bytes(2, "big") + header + body
    return packet + b"\x00\x00"


@pytest.mark.parametrize("behind", [b"", PING, PING[:1]])
def test_a_telecommand_within_a_damaged_one_is_not_executed(behind: bytes):
    splitter = PacketSplitter(KNOWN)
    damaged = kept_for_later()
    found = splitter.feed(damaged + behind, 0)
    assert found[0].error is Error.BAD_CRC
    assert [item.packet for item in found[1:]] == ([PING] if behind == PING else [])
    assert splitter.skipped_bytes == len(damaged)


def test_a_telecommand_within_one_whose_application_is_damaged_is_not_executed():
    splitter = PacketSplitter(KNOWN)
    damaged = bytearray(kept_for_later())
    damaged[0] ^= 0x01
    assert [item.packet for item in splitter.feed(bytes(damaged) + PING, 0)] == [PING]
    assert splitter.skipped_bytes == len(damaged)


def test_garbage_before_a_telecommand_costs_the_garbage_only():
    splitter = PacketSplitter(KNOWN)
    (found,) = splitter.feed(b"\xff\xfe" + PING, 0)
    assert (found.packet, found.error) == (PING, None)
