"""CAN logs of other tools: every kind of frame as python-can's own writers put it down."""

import can
import pytest

from fsw.drivers.ports.can_log import read_can_log
from fsw.drivers.wire import frame_list, recorded_bytes
from fsw.errors import ConfigError

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
