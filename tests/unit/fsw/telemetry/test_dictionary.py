"""The dictionary is complete and unambiguous: every packet can be told from every other."""

import re
import subprocess
import sys
from pathlib import Path

from fsw.drivers.codecs.can_error import BusCondition
from fsw.drivers.wire import Reject
from fsw.estimators.model.inertia import NAMES
from fsw.health.incidents import RECOVERED
from fsw.messages.findings import Fault, severity
from fsw.telemetry.dictionary import DICTIONARY, Type
from fsw.telemetry.dictionary.codes import Error, Function
from fsw.telemetry.dictionary.housekeeping import COORDINATES, REASONS, SETS
from fsw.telemetry.dictionary.parameters import value_ids

SNAKE = re.compile(r"[A-Za-z][A-Za-z0-9_]*$")


def test_every_packet_is_told_from_every_other():
    keys = {(p.apid, p.service, p.subtype, p.match) for p in DICTIONARY.packets}
    assert len(keys) == len(DICTIONARY.packets)
    assert len({p.name for p in DICTIONARY.packets}) == len(DICTIONARY.packets)
    for packet in DICTIONARY.packets:
        names = [f.name for f in packet.fields]
        assert len(set(names)) == len(names)
        assert all(SNAKE.match(name) for name in names)
        assert all(name in names for name, _ in packet.match)


def test_every_telecommand_is_told_from_every_other():
    keys = {(t.service, t.subtype, t.match) for t in DICTIONARY.telecommands}
    assert len(keys) == len(DICTIONARY.telecommands)
    functions = [t.function_id for t in DICTIONARY.telecommands if t.function_id is not None]
    assert sorted(functions) == sorted(Function)


def test_telemetry_is_flat_and_of_fixed_size():
    for packet in DICTIONARY.packets:
        assert all(f.type is not Type.BYTES for f in packet.fields)
        assert all(f.size > 0 for f in packet.fields if f.type is Type.TEXT)


def test_labels_of_an_enumerated_field_fit_its_type():
    bits = {Type.U8: 8, Type.U16: 16}
    everything = [f for p in DICTIONARY.packets for f in p.fields]
    everything += [f for t in DICTIONARY.telecommands for f in t.arguments]
    for field in everything:
        if field.enumeration is not None:
            assert max(field.enumeration.labels) < 1 << bits[field.type]


def test_the_services_asked_for_are_there():
    told = {(p.service, p.subtype) for p in DICTIONARY.packets}
    asked = {(t.service, t.subtype) for t in DICTIONARY.telecommands}
    assert {(1, k) for k in (1, 2, 3, 4, 5, 6, 7, 8, 10)} <= told
    assert {(3, 25), (3, 35), (5, 1), (5, 2), (5, 3), (5, 4), (5, 8), (17, 2), (20, 2)} <= told
    assert {(3, k) for k in (5, 6, 27, 31, 33)} <= asked
    assert {(5, 5), (5, 6), (5, 7), (8, 1), (17, 1)} <= asked
    assert {s for s, _ in told} == {1, 3, 5, 6, 8, 9, 11, 12, 15, 17, 19, 20, 21, 23}
    assert [dict(p.match)["sid"] for p in SETS] == [*range(1, 9), 20]
    assert {"BAD_CRC", "REPLAY", "INSUFFICIENT_EXCITATION"} <= {e.name for e in Error}


def test_it_speaks_of_the_estimators_own_coordinates_and_the_drivers_own_reasons():
    assert COORDINATES == NAMES
    assert {str(reason) for reason in Reject} == set(REASONS)


def test_every_value_number_stands_for_one_field():
    assert len(set(value_ids().values())) == len(value_ids())
    assert max(value_ids()) < 1 << 16


def test_every_fault_and_every_event_in_the_source_has_a_number():
    known = {event.code for event in DICTIONARY.events}
    source = "".join(path.read_text() for path in (Path(__file__).parents[4] / "fsw").rglob("*.py"))
    raised = set(re.findall(r'"(?:info|low|medium|high)",\s*"([A-Z_]+)"', source))
    raised |= set(re.findall(r'"((?:CAN|NODE)_[A-Z_]+)"', source))  # named apart from severity
    raised |= {f"CAN_{condition.upper()}" for condition in BusCondition}
    assert raised | {str(fault) for fault in Fault} | {RECOVERED} <= known, (
        "add them to fsw/telemetry/dictionary/events.py, then python -m offline.exports"
    )
    assert len({event.id for event in DICTIONARY.events}) == len(DICTIONARY.events)
    told = {event.code: event.severity.name.lower() for event in DICTIONARY.events}
    assert {str(fault): severity(fault) for fault in Fault}.items() <= told.items()


def test_the_order_of_faults_keeps_the_numbers_that_the_ground_knows():
    numbers = {event.code: event.id for event in DICTIONARY.events}
    assert [numbers[str(fault)] for fault in Fault] == [*range(200, 200 + len(Fault))]
    told = {"SYNC_LOST": 200, "JOINT_SILENT": 210, "WHEEL_SILENT": 262, "SYNC_CREEPS": 267}
    assert told.items() <= numbers.items()


def test_its_crc_is_the_same_in_every_process():
    line = "from fsw.telemetry.dictionary import dictionary_crc32 as c; print(c())"
    found = {
        subprocess.run(
            [sys.executable, "-c", line], capture_output=True, check=True, env={"PYTHONHASHSEED": s}
        ).stdout
        for s in ("1", "2")
    }
    assert len(found) == 1
