"""CAN logs of other tools: every kind of frame as python-can's own writers put it down."""

import gzip
import re
from datetime import datetime

import can
import pytest

from fsw.drivers.wire import frame_list, recorded_bytes
from fsw.errors import ConfigError
from offline.can_logs.reading import read_can_log

T_S, T_NS = 1_760_000_000.25, 1_760_000_000_250_000_000


def log(path, *messages: can.Message):
    with can.Logger(path) as logger:
        for message in messages:
            logger.on_message_received(message)
    return path


def classic(**changes: object) -> can.Message:
    values = {"timestamp": T_S, "arbitration_id": 0x191, "is_extended_id": False, "channel": 0}
    return can.Message(**(values | {"data": b"\x01\x02"} | changes))


@pytest.mark.parametrize("suffix", [".log", ".blf", ".asc"])
def test_flexible_extended_and_remote_frames_keep_what_they_are(tmp_path, suffix):
    path = log(
        tmp_path / f"a{suffix}",
        classic(),
        classic(timestamp=T_S + 1e-6, is_fd=True, bitrate_switch=True, data=bytes(range(20))),
        classic(timestamp=T_S + 2e-6, arbitration_id=0x18FEF100, is_extended_id=True),
        classic(timestamp=T_S + 3e-6, is_remote_frame=True, data=b""),
    )
    frames = read_can_log(path).frames
    assert [len(data) for data in recorded_bytes(frames)] == [16, 72, 16, 16]
    plain, flexible, extended, remote = frame_list(frames)
    assert (plain.t_ns, plain.can_id, plain.data) == (T_NS, 0x191, b"\x01\x02")
    assert (flexible.is_fd, flexible.bitrate_switch, flexible.data) == (
        True,
        True,
        bytes(range(20)),
    )
    assert flexible.t_ns - plain.t_ns == 1000
    assert (extended.is_extended, extended.can_id) == (True, 0x18FEF100)
    assert remote.is_remote


def test_one_channel_of_several_is_chosen(tmp_path):
    path = log(tmp_path / "a.blf", classic(), classic(channel=1, data=b"\x03"))
    assert frame_list(read_can_log(path, "1").frames)[0].data == b"\x03"
    with pytest.raises(ConfigError, match=r"has the channels 0, 1; choose one as a\.blf:CHANNEL"):
        read_can_log(path)


def test_an_unknown_kind_of_log_is_refused(tmp_path):
    (tmp_path / "a.pcap").write_bytes(b"1234")
    with pytest.raises(ConfigError, match=r"a\.pcap: cannot be read as a CAN log"):
        read_can_log(tmp_path / "a.pcap")


def test_a_log_that_was_not_closed_is_refused(tmp_path):
    path = log(tmp_path / "a.blf", *(classic(timestamp=T_S + k) for k in range(50)))
    path.write_bytes(path.read_bytes() + b"1234")
    with pytest.raises(ConfigError, match=r"a\.blf: "):
        read_can_log(path)


TRC = ";$FILEVERSION=1.1\n;$STARTTIME={}\n     1)       0.0  Rx         0191  2  01 02\n"


def test_a_header_that_cannot_be_read_ends_the_reading(tmp_path):
    (tmp_path / "a.trc").write_text(TRC.format("45939,5"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"a\.trc: cannot be read as a CAN log: .*45939,5"):
        read_can_log(tmp_path / "a.trc")


def test_the_start_of_a_trc_is_known_to_be_utc(tmp_path):
    (tmp_path / "a.trc").write_text(TRC.format("45939.5"), encoding="utf-8")
    log = read_can_log(tmp_path / "a.trc")
    assert frame_list(log.frames)[0].t_ns == int((45939.5 - 25569) * 86400) * 10**9
    assert any("read as UTC" in note for note in log.notes)
    text = TRC.format("").replace(";$STARTTIME=\n", "")
    (tmp_path / "a.trc").write_text(text, encoding="utf-8")
    assert any("count from 0" in note for note in read_can_log(tmp_path / "a.trc").notes)


@pytest.mark.parametrize("suffix", [".BLF", ".Asc", ".TRC"])
def test_the_case_of_a_suffix_does_not_matter(tmp_path, suffix):
    path = log(tmp_path / f"a{suffix.lower()}", classic())
    path = path.rename(tmp_path / f"b{suffix}")
    assert len(read_can_log(path).frames) == 1


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (gzip.compress(b"(1.0) can0 191#01\n", mtime=0), "is compressed; unpack it: gzip -d"),
        ("(1.0) can0 191#01\n".encode("utf-16"), "is not text in ASCII or UTF-8"),
    ],
)
def test_a_log_that_is_no_text_is_said_to_be_none(tmp_path, data, words):
    (tmp_path / "a.log").write_bytes(data)
    with pytest.raises(ConfigError, match=re.escape(words)):
        read_can_log(tmp_path / "a.log")


ASC = "date {}\nbase hex  timestamps absolute\n   0.5 1  191             Rx   d 1 01\n"


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
@pytest.mark.parametrize(
    ("name", "month"),
    [
        *[("Mrz", 3), ("März", 3), ("Mai", 5), ("Okt.", 10), ("Dez", 12)],
        *[("janv.", 1), ("févr.", 2), ("mars", 3), ("avr.", 4), ("juin", 6), ("juil.", 7)],
        *[("août", 8), ("déc.", 12), ("gen", 1), ("mag", 5), ("giu", 6), ("lug", 7), ("ago", 8)],
        *[("set", 9), ("ott", 10), ("dic", 12), ("ene", 1), ("abr", 4), ("June", 6), ("jul", 7)],
        *[("Jän.", 1), ("fevr.", 2), ("aout", 8)],
    ],
)
def test_months_of_an_asc_may_be_of_other_languages(tmp_path, name, month, encoding):
    path = tmp_path / "a.asc"
    path.write_text(ASC.format(f"lun. {name} 9 08:53:30.042 2025"), encoding=encoding)
    start = datetime(2025, month, 9, 8, 53, 30, 542000)  # noqa: DTZ001 local time
    assert frame_list(read_can_log(path).frames)[0].t_ns == round(start.timestamp() * 1e3) * 10**6


@pytest.mark.parametrize("moment", ["2025-10-09 08:53:30.042", "Mon Foo 9 08:53:30 2025"])
def test_a_date_of_an_asc_that_is_not_understood_is_refused(tmp_path, moment):
    (tmp_path / "a.asc").write_text(ASC.format(moment), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"line 1: .* must be as 'Thu Oct 9 08:53:30"):
        read_can_log(tmp_path / "a.asc")
