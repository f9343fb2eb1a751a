"""Every rejection code, provoked; what is rejected has no effect and is counted."""

import binascii
import struct

import pytest

from fsw.messages.commands import Code, JobReport
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import parameters_data, telecommand_packet
from fsw.telemetry.link.telecommands import TcError, TelecommandReader
from fsw.telemetry.state.mode_machine import ModeMachine
from tests.support.application_cases import BEGUN, Flight

PING = telecommand_packet(DICTIONARY.telecommand("PING"), {}, 1)


def with_crc(data: bytes) -> bytes:
    return data + struct.pack(">H", binascii.crc_hqx(data, 0xFFFF))


def changed(at: int, value: int, packet: bytes = PING) -> bytes:
    """A packet with one other byte and its CRC made right again."""
    data = bytearray(packet[:-2])
    data[at] = value
    return with_crc(bytes(data))


CASES = {
    "crc": (Error.BAD_CRC, PING[:-1] + bytes((PING[-1] ^ 1,))),
    "cut": (Error.BAD_LENGTH, PING[:-1]),
    "empty": (Error.BAD_LENGTH, b""),
    "longer than it says": (Error.BAD_LENGTH, PING + b"\0"),
    "arguments too many": (
        Error.BAD_LENGTH,
        with_crc(PING[:4] + b"\x00\x07" + PING[6:-2] + b"\x00"),
    ),
    "other application": (Error.WRONG_APID, changed(1, 0x65)),
    "service": (Error.UNKNOWN_SERVICE, changed(7, 99)),
    "subtype": (Error.UNKNOWN_SUBTYPE, changed(8, 99)),
    "another standard": (Error.BAD_ARG, changed(6, 0x1F)),
    "segmented": (Error.BAD_ARG, changed(2, 0x40)),
    "telemetry": (Error.BAD_ARG, changed(0, 0x08)),
}


@pytest.mark.parametrize("name", CASES)
def test_wrong_packets_are_rejected_with_their_reason(flight: Flight, name):
    error, packet = CASES[name]
    flight.app.executor.receive(packet)
    assert flight.error() is error
    told = flight.packets[-2 if flight.packets[-1].packet.name == "event_low" else -1]
    name = "routing_failure" if error is Error.WRONG_APID else "acceptance_failure"
    assert told.packet.name == name
    assert flight.app.executor.counters.tc_rejected == 1
    assert flight.app.executor.counters.tc_accepted == 0
    assert "TC_REJECTED" in flight.codes


PLAN = {"duration_s": 20.0, "starts": 1, "seed": 0}
ARGUMENTS = [
    ("REPORT_SET", {"sid": 9}, Error.BAD_ARG),
    ("SET_INTERVAL", {"sid": 1, "interval_ms": 9}, Error.OUT_OF_RANGE),
    ("SET_INTERVAL", {"sid": 1, "interval_ms": 3_600_001}, Error.OUT_OF_RANGE),
    ("ENABLE_EVENT", {"event": 0}, Error.BAD_ARG),
    ("ENABLE_EVENT", {"event": 9999}, Error.BAD_ARG),
    ("SET_MODE", {"mode": 4}, Error.BAD_ARG),
    ("SET_TIME_REPORT_RATE", {"exponent": 9}, Error.OUT_OF_RANGE),
    ("RUN_BATCH", {"method": 0, "unknown": 0, "last_s": 0.0}, Error.BAD_ARG),
    ("RUN_BATCH", {"method": 1, "unknown": 0, "last_s": -1.0}, Error.OUT_OF_RANGE),
    ("RUN_PLAN", PLAN | {"duration_s": 0.5}, Error.OUT_OF_RANGE),
    ("RUN_PLAN", PLAN | {"duration_s": float("nan")}, Error.OUT_OF_RANGE),
    ("RUN_PLAN", PLAN | {"duration_s": float("inf")}, Error.OUT_OF_RANGE),
    ("RUN_PLAN", PLAN | {"starts": 0}, Error.OUT_OF_RANGE),
    ("RUN_PLAN", PLAN | {"starts": 65}, Error.OUT_OF_RANGE),
    ("REPORT_PARAMETERS", {"count": 1, "parameter": 99}, Error.BAD_ARG),
    ("REPORT_PARAMETERS", {"count": 0, "parameter": 1}, Error.OUT_OF_RANGE),
    ("REPORT_PARAMETERS", {"count": 2, "parameter": 1}, Error.BAD_LENGTH),
    ("LIST_FILES", {"path": "", "first": 1}, Error.BAD_ARG),
    ("LIST_FILES", {"path": "f\nles", "first": 1}, Error.BAD_ARG),
    ("LIST_FILES", {"path": "elsewhere", "first": 1}, Error.BAD_ARG),
    ("LIST_FILES", {"path": "files/../..", "first": 1}, Error.BAD_ARG),
    ("LIST_FILES", {"path": "files/none", "first": 1}, Error.FILE_NOT_FOUND),
    ("REPORT_MONITOR", {"monitor": 1}, Error.BAD_ARG),
    ("EVENT_LOG_DUMP", {"entries": 0}, Error.OUT_OF_RANGE),
    ("RESTART", {"key": 0xB007}, Error.WRONG_MODE),
    ("RESTORE_STATE", {}, None),
    ("TBL_VALIDATE", {"table": 1}, Error.NOT_STAGED),
    ("TBL_VALIDATE", {"table": 7}, Error.BAD_ARG),
    ("TBL_LOAD", {"table": 1, "size_bytes": 0, "crc32": 0}, Error.OUT_OF_RANGE),
    ("TBL_DATA", {"table": 1, "offset": 0, "data": b""}, Error.BAD_LENGTH),
]


@pytest.mark.parametrize(("name", "values", "error"), ARGUMENTS)
def test_wrong_arguments_are_rejected_with_their_reason(flight: Flight, name, values, error):
    if error is None:
        assert flight.send(name, values) == BEGUN
    else:
        assert flight.refused(name, values) is error


def test_an_unknown_function_is_named(flight: Flight):
    packet = telecommand_packet(DICTIONARY.telecommand("RESET_COUNTERS"), {}, 1)
    flight.app.executor.receive(changed(12, 0xEE, packet))
    assert flight.error() is Error.BAD_ARG
    assert flight.last("acceptance_failure")["error_value"] == 0xEE


def test_text_that_no_zero_ends_is_refused():
    packet = telecommand_packet(DICTIONARY.telecommand("DELETE_FILE"), {"path": "f" * 999}, 1)
    assert packet[-3] == 0
    TelecommandReader().read(packet)
    with pytest.raises(TcError) as caught:
        TelecommandReader().read(changed(len(packet) - 3, ord("f"), packet))
    assert caught.value.error is Error.BAD_ARG


LOOP = [
    (Code.JOB_RUNNING, "", Error.BUSY),
    (Code.QUEUE_FULL, "", Error.BUSY),
    (Code.NO_JOB, "", Error.NOT_STAGED),
    (Code.NO_RESULT, "", Error.NOT_STAGED),
    (Code.NO_STATE, "", Error.NOT_STAGED),
    (Code.NOT_SUPPORTED, "", Error.NOT_SUPPORTED),
    (Code.BAD_ARGUMENT, "", Error.BAD_ARG),
    (Code.TIMEOUT, "", Error.TIMEOUT),
    (Code.ESTIMATOR, "diverged", Error.FAILED),
    (Code.ESTIMATOR, "the batch ended with NOT_CONVERGED", Error.NOT_CONVERGED),
    (Code.ESTIMATOR, "INSUFFICIENT_EXCITATION", Error.INSUFFICIENT_EXCITATION),
]


@pytest.mark.parametrize(("code", "text", "error"), LOOP)
def test_what_the_loop_refuses_fails_with_its_reason(flight: Flight, code, text, error):
    assert flight.send("ADOPT_RESULT") == BEGUN
    flight.answer(code, text)
    assert flight.error() is error
    assert flight.app.executor.counters.tc_failed == 1
    assert "TC_FAILED" in flight.codes


def test_a_full_ring_is_busy(flight: Flight):
    flight.ring_full = True
    assert "completion_failure" in flight.send("RESET_ESTIMATOR")
    assert flight.error() is Error.BUSY


def test_a_loop_that_does_not_answer_is_a_timeout(flight: Flight):
    flight.send("RESET_ESTIMATOR")
    flight.wait(6.0)
    assert flight.error() is Error.TIMEOUT


@pytest.mark.parametrize("status", ["NOT_CONVERGED", "INSUFFICIENT_EXCITATION"])
def test_a_batch_that_ends_badly_fails_with_its_status(flight: Flight, status):
    flight.send("RUN_BATCH", {"method": "FUSED", "unknown": 0, "last_s": 0.0})
    number = flight.commands[0].id
    flight.answer()
    told = flight.refused("RUN_BATCH", {"method": "FUSED", "unknown": 0, "last_s": 0.0})
    assert told is Error.BUSY
    report = JobReport(id=number, state="done", progress=1.0, result={"status": status})
    flight.app.job(report)
    assert flight.error() is Error[status]


def test_a_recorder_that_is_busy_or_idle_says_so(flight: Flight):
    flight.send("REC_START")
    assert "completion_failure" in flight.send("REC_START")
    assert flight.error() is Error.BUSY
    flight.send("REC_STOP")
    assert "completion_failure" in flight.send("REC_STOP")
    assert flight.error() is Error.NOT_STAGED


def test_what_is_not_authentic_or_old_is_refused_and_told(flight: Flight):
    for error in (Error.NOT_AUTHENTICATED, Error.REPLAY):
        flight.app.executor.refuse(PING, error, "")
        assert flight.error() is error
    assert flight.codes.count("TC_AUTH_FAILED") == 2
    before = len(flight.packets)
    flight.app.executor.refuse(b"", Error.NOT_AUTHENTICATED, "no packet is known")
    assert "acceptance_failure" not in [p.packet.name for p in flight.packets[before:]]


def test_the_same_request_twice_at_once_is_busy(flight: Flight):
    packet = telecommand_packet(DICTIONARY.telecommand("RESET_ESTIMATOR"), {}, 5)
    assert flight.app.executor.receive(packet)
    assert not flight.app.executor.receive(packet)
    assert flight.error() is Error.BUSY


def unforeseen(*_arguments, **_keywords):
    raise RuntimeError("nobody foresaw this " + "x" * 5000)


def test_an_error_nobody_foresaw_rejects_or_fails_the_telecommand(flight: Flight):
    executor = flight.app.executor
    executor.add({"PING": unforeseen, "REPORT_VERSION": lambda _: unforeseen})
    assert flight.refused("PING") is Error.FAILED
    assert flight.send("REPORT_VERSION")[-2:] == ["event_medium", "completion_failure"][::-1]
    assert flight.error() is Error.FAILED
    assert flight.codes[-2:] == ["TC_REJECTED", "TC_FAILED"]
    assert all(len(event.text) <= 1000 for event in flight.events)
    assert "completion_success" in flight.send("REPORT_DISABLED_EVENTS")


def test_an_error_nobody_foresaw_after_the_loops_answer_fails_the_telecommand(
    flight: Flight, monkeypatch
):
    monkeypatch.setattr(ModeMachine, "leave_safe", unforeseen)
    flight.send("SET_MODE", {"mode": "STANDBY"})
    flight.answer()
    assert flight.error() is Error.FAILED
    assert flight.codes[-1] == "TC_FAILED"


def test_what_cannot_be_undone_after_a_refusal_fails_the_telecommand(flight: Flight):
    flight.app.context.parameters.store.discard = unforeseen
    flight.up(identifying=False)
    values = parameters_data({11: 1e6})
    flight.send("SET_PARAMETERS", {"count": 1, "parameter": 11, "value": values[3:]})
    flight.answer(Code.BAD_ARGUMENT, "no")
    assert flight.error() is Error.FAILED
