"""Telecommands from the XTCE and text, against packets made by hand from the dictionary."""

import struct

import pytest
from spacepackets.ecss.tc import PusTc

from fsw.telemetry.dictionary import DICTIONARY
from ground.commands import Catalogue, given_arguments
from ground.errors import UsageError


@pytest.fixture(scope="module")
def catalogue() -> Catalogue:
    return Catalogue()


def data_of(packet: bytes) -> tuple[int, int, bytes]:
    """Return service, subtype and application data; the CRC is checked."""
    tc = PusTc.unpack(packet)
    assert (tc.apid, tc.seq_count) == (100, 9)
    return tc.service, tc.pus_tc_sec_header.message_subtype, bytes(tc.app_data)


def test_every_telecommand_of_the_dictionary_is_there(catalogue):
    singles = {item.name for item in DICTIONARY.telecommands} - {"SET_PARAMETERS"}
    settings = {f"SET_{item.name}" for item in DICTIONARY.parameters}
    assert set(catalogue.commands) == singles | settings


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("PING", {}, (17, 1, b"")),
        ("ping", {}, (17, 1, b"")),
        ("ENABLE_SET", {"sid": "estimate"}, (3, 5, struct.pack(">BH", 1, 2))),
        ("ENABLE_SET", {"sid": "20"}, (3, 5, struct.pack(">BH", 1, 20))),
        (
            "SET_INTERVAL",
            {"sid": "HEALTH", "interval_ms": "100"},
            (3, 31, struct.pack(">BHI", 1, 1, 100)),
        ),
        ("SET_MODE", {"mode": "SAFE"}, (8, 1, struct.pack(">HB", 1, 1))),
        (
            "RUN_BATCH",
            {"method": "FUSED", "unknown": "TARGET", "last_s": "30.5"},
            (8, 1, struct.pack(">HBBf", 20, 5, 2, 30.5)),
        ),
        (
            "DOWNLINK_FILE",
            {"path": "files/a", "remove": "NO"},
            (8, 1, struct.pack(">H96sB", 42, b"files/a", 0)),
        ),
        (
            "TBL_DATA",
            {"table": "NOISE", "offset": "16", "data": "00ff10"},
            (8, 1, struct.pack(">HBI", 31, 2, 16) + b"\x00\xff\x10"),
        ),
        (
            "SET_command_loss_time_s",
            {"value": "60"},
            (20, 3, struct.pack(">BHf", 1, 1, 60.0)),
        ),
        (
            "SET_PARAMETERS",
            {"command_loss_time_s": "60", "time_report_exponent": "2"},
            (20, 3, struct.pack(">BHfHB", 2, 1, 60.0, 5, 2)),
        ),
        ("REPORT_PARAMETERS", {"parameter": "settle_blocks"}, (20, 1, struct.pack(">BH", 1, 13))),
    ],
)
def test_arguments_given_as_text_become_what_the_dictionary_says(catalogue, name, given, expected):
    assert data_of(catalogue.build(name, given, 9)) == expected


def test_a_command_can_wait_for_its_time(catalogue):
    inner = catalogue.build("PING", {}, 8)
    service, subtype, data = data_of(catalogue.at(inner, 100.25, 9))
    assert (service, subtype) == (11, 4)
    assert data == b"\x01\x2f" + struct.pack(">I", 100) + bytes((0x40, 0, 0)) + inner


@pytest.mark.parametrize(
    ("name", "given", "words"),
    [
        ("PINK", {}, "PINK: no such telecommand"),
        ("MODE", {}, "did you mean SET_MODE"),
        ("PNIG", {}, "did you mean PING"),
        ("REPORT_SET", {"sid": "ESTIMATES"}, "one of HEALTH"),
        ("REPORT_SET", {"sid": "9"}, "one of HEALTH"),
        ("SET_command_loss_time_s", {"value": "inf"}, "finite"),
        ("SET_command_loss_time_s", {"value": "nan"}, "finite"),
        ("RUN_BATCH", {"method": "FUSED", "unknown": "TARGET", "last_s": "Infinity"}, "finite"),
        ("DELETE_FILE", {"path": ""}, "not empty"),
        ("DELETE_FILE", {"path": "f\u00fc"}, "ASCII"),
        ("PING", {"x": "1"}, "x: no such argument"),
        ("SET_MODE", {}, "mode: missing"),
        ("SET_MODE", {"mode": "BOOT"}, "one of SAFE, STANDBY, IDENTIFY"),
        ("SET_INTERVAL", {"sid": "HEALTH", "interval_ms": "1"}, "must be 10 to"),
        ("SET_INTERVAL", {"sid": "HEALTH", "interval_ms": "x"}, "a number"),
        ("SET_time_report_exponent", {"value": "-1"}, "must be 0 to 8"),
        ("DELETE_FILE", {"path": "x" * 97}, "at most 95"),
        ("TBL_DATA", {"table": "NOISE", "offset": "0", "data": "xyz"}, "hex digits or @FILE"),
        ("SET_PARAMETERS", {}, "one or more"),
        ("SET_PARAMETERS", {"nothing": "1"}, "no such telecommand"),
    ],
)
def test_what_the_dictionary_does_not_have_is_refused_here(catalogue, name, given, words):
    with pytest.raises(UsageError, match=words):
        catalogue.build(name, given, 9)


def test_by_force_values_out_of_range_are_sent(catalogue):
    given = {"sid": "HEALTH", "interval_ms": "1"}
    packet = catalogue.build("SET_INTERVAL", given, 9, checked=False)
    assert data_of(packet) == (3, 31, struct.pack(">BHI", 1, 1, 1))


def test_arguments_need_a_name():
    assert given_arguments(["a=1", "b=x=y"]) == {"a": "1", "b": "x=y"}
    with pytest.raises(UsageError, match="NAME=VALUE"):
        given_arguments(["a"])
    with pytest.raises(UsageError, match="twice"):
        given_arguments(["a=1", "a=2"])
