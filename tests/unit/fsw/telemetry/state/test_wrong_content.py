"""State files with a right CRC and wrong content are damaged generations, never an exception."""

import json

import pytest

from fsw.telemetry.state.boot import Boot
from fsw.telemetry.state.documents import read_document
from fsw.telemetry.state.parameter_values import stored_values
from fsw.telemetry.state.store import GenerationStore
from tests.support.application_cases import Flight, flight_config

DEEP = b"[" * 100_000
WRONG = [
    DEEP,
    b"",
    b"\xff",
    b"null",
    b"5",
    b"[]",
    b"{}",
    b'"text"',
    b'{"count": "x", "cause": 0, "running": true, "next_cause": 0}',
    b'{"count": 1e999, "cause": 0, "running": true, "next_cause": 0}',
    b'{"count": 3, "cause": 99, "running": false, "next_cause": -7}',
    b'{"count": 3, "cause": [], "running": false, "next_cause": {}}',
    b'{"enabled": 1, "definitions": [{"event": 5}]}',
    b'{"enabled": 1, "definitions": [{"event": [], "packet": "00", "enabled": 1}]}',
    b'{"enabled": 1, "entries": 7, "stores": [], "epoch": {}}',
    b'{"gate_probability": NaN}',
    b'{"gate_probability": [1]}',
]


@pytest.mark.parametrize("content", WRONG)
def test_a_start_is_the_first_when_the_last_cannot_be_read(tmp_path, content: bytes):
    store = GenerationStore(tmp_path)
    store.write(content)
    assert Boot.begin(store, resume=False).count == 1


def test_the_start_before_a_wrong_one_is_used(tmp_path):
    store = GenerationStore(tmp_path)
    for _ in range(3):
        boot = Boot.begin(store, resume=False)
    store.write(DEEP)
    assert boot.count == 3
    assert Boot.begin(store, resume=False).count == 4


@pytest.mark.parametrize("content", WRONG)
def test_parameters_of_wrong_content_are_those_of_the_configuration(tmp_path, content: bytes):
    store = GenerationStore(tmp_path)
    store.write(content)
    values, damaged = stored_values(store)
    assert values == {}
    assert damaged == (content != b"{}")


@pytest.mark.parametrize("content", WRONG)
def test_a_parser_never_raises(tmp_path, content: bytes):
    store = GenerationStore(tmp_path)
    store.write(content)
    assert read_document(store, lambda d: int(d["count"]) + d["cause"] + [1][d["next_cause"]])[
        0
    ] in (None, 1, 3)


@pytest.mark.parametrize("content", WRONG)
def test_the_application_starts_with_wrong_content_everywhere(arm, content: bytes):
    config = flight_config(arm)
    flight = Flight(config)
    flight.up()
    state = flight.app.context.state
    flight.app.close()
    folders = {path.parent for path in state.rglob("*.gen")}
    assert folders
    for folder in (*folders, *(state / name for name in ("schedule", "event_actions"))):
        GenerationStore(folder).write(content)
    for path in state.rglob("*.jsonl"):
        path.write_bytes(content + b"\n" + json.dumps([1]).encode() + b"\n")
    again = Flight(config)
    again.up()
    assert again.send("PING")
    again.app.close()
