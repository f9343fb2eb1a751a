from fsw.drivers.sources.bus_errors import BusErrors
from fsw.drivers.wire import CanFrame

MS = 1_000_000


def error(t_ms: int, classes: int, data: str = "") -> CanFrame:
    return CanFrame(t_ms * MS, classes, bytes.fromhex(data).ljust(8, b"\0"), is_error=True)


def test_a_change_of_the_controllers_state_is_told_once():
    errors = BusErrors()
    told = []
    for t_ms, classes, data in [
        (0, 0x204, "00200000000080 00"),
        (1, 0x204, "00200000000088 00"),
        (2, 0x040, ""),
        (3, 0x040, ""),
        (4, 0x100, ""),
        (5, 0x204, "0040000000000000"),
    ]:
        told += errors.feed(error(t_ms, classes, data))
    assert [(severity, code) for severity, code, _ in told] == [
        ("medium", "CAN_ERROR_PASSIVE"),
        ("high", "CAN_BUS_OFF"),
        ("info", "CAN_RESTARTED"),
        ("info", "CAN_ERROR_ACTIVE"),
    ]
    assert "128 sending, 0 receiving" in told[0][2]
    assert (errors.counts["error_passive"], errors.counts["bus_off"]) == (2, 2)


def test_a_condition_that_keeps_coming_is_told_once_a_second_and_counted_always():
    errors = BusErrors()
    told = [e for t_ms in range(2500) for e in errors.feed(error(t_ms, 0x002))]
    assert [text for _, _, text in told] == [
        "arbitration lost, 1 in all",
        "arbitration lost, 1001 in all",
        "arbitration lost, 2001 in all",
    ]
    assert errors.counts["arbitration_lost"] == errors.frames == 2500


def test_a_cut_error_frame_changes_the_frame_counter_only():
    errors = BusErrors()
    assert errors.feed(CanFrame(0, 0x040, b"", is_error=True)) == []
    assert (errors.frames, sum(errors.counts.values())) == (1, 0)
