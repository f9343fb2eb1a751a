"""The simulated wheel node: the ICD's vector, its rate, its states."""

from hil.devices.canopen import Reading
from hil.devices.wheel import WheelNode, encode_tpdo1, encode_tpdo2

NO_READING = Reading(0, 0, 0, 0, False)


def node(**changes: object) -> WheelNode:
    data: dict[str, object] = {
        "node_id": 0x21,
        "joint": 8,
        "syncs_per_report": 10,
        "measure": lambda: (300.0, 0.1234),
    }
    return WheelNode(**(data | changes))  # type: ignore[arg-type]


def test_vector_of_the_icd() -> None:
    assert encode_tpdo1(300.0, 0.1234, 0x09, 42) == bytes.fromhex("8119bf2fd204092a")
    assert encode_tpdo2(25.0) == b"\xfa\0"


def test_fields_saturate() -> None:
    assert encode_tpdo1(1e6, -100.0, 0x09, 1) == bytes.fromhex("ffffff7f00800901")


def test_every_tenth_sync_is_answered_and_every_tenth_report_has_a_temperature() -> None:
    own = node()
    answers = [own.on_sync(k % 240 + 1, NO_READING, 0) for k in range(1000)]
    due = [k for k, pdos in enumerate(answers) if pdos]
    assert due == list(range(9, 1000, 10))
    assert answers[9][0][-1] == 10  # the SYNC it answers
    assert [len(answers[k]) for k in due].count(2) == 10


def test_a_stopped_or_dead_node_says_nothing() -> None:
    own = node(syncs_per_report=1)
    assert own.on_sync(1, NO_READING, 0)
    own.on_nmt(0x02, 0x21)
    assert own.on_sync(2, NO_READING, 0) == ()
    own.on_nmt(0x01, 0)
    own.silent = True
    assert own.on_sync(3, NO_READING, 0) == ()
