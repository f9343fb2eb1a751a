import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.drivers.codecs.can_error import BusCondition, BusErrorReport, decode_error
from fsw.drivers.wire import Reject

# identifier bits and data as the kernel's drivers send them (linux/can/error.h)
CASES = [
    (0x040, "0000000000000000", ["bus_off"]),
    (0x100, "0000000000000000", ["restarted"]),
    (0x002, "1300000000000000", ["arbitration_lost"]),
    (0x020, "0000000000000000", ["no_acknowledge"]),
    (0x088, "0000040800000000", ["protocol", "bus_error"]),
    (0x004, "0001000000000000", ["controller_overflow"]),
    (0x004, "0008000000000000", ["error_warning"]),
    (0x004, "0020000000000000", ["error_passive"]),
    (0x004, "0040000000000000", ["error_active"]),
    (0x010, "0000000044000000", ["transceiver"]),
    (0x001, "0000000000000000", ["tx_timeout"]),
]


@pytest.mark.parametrize(("classes", "data", "conditions"), CASES)
def test_each_error_class_is_told(classes, data, conditions):
    report = decode_error(classes, bytes.fromhex(data))
    assert isinstance(report, BusErrorReport)
    assert list(report.conditions) == conditions
    assert report.transmit_errors is None


def test_error_counters_are_read_where_the_controller_gives_them():
    report = decode_error(0x204, bytes.fromhex("00200000000080 7f"))
    assert report == BusErrorReport((BusCondition.ERROR_PASSIVE,), 128, 127)


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=64))
def test_any_error_frame_is_decoded_or_refused(classes, data):
    report = decode_error(classes, data)
    assert (report is Reject.LENGTH) == (len(data) != 8)
