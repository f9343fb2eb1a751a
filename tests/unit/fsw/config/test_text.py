"""YAML text from outside: bounded in size, depth and nodes, without aliases; faults are short."""

import pytest
from pydantic import BaseModel, ConfigDict, ValidationError

from fsw.config.text import (
    MAX_DEPTH,
    MAX_FAULTS,
    MAX_NODES,
    MAX_TEXT_BYTES,
    TextError,
    explain,
    read_yaml,
)
from fsw.messages import MAX_EVENT_TEXT, Event

BOMB = b"a: &a [x,x,x,x,x,x,x,x,x]\n" + b"".join(
    b"%c: &%c [*%c,*%c,*%c,*%c,*%c,*%c,*%c,*%c,*%c]\n" % (k, k, *[k - 1] * 9) for k in b"bcdefghi"
)


class Model(BaseModel):
    """Any model."""

    model_config = ConfigDict(extra="forbid")
    numbers: tuple[float, ...] = ()
    word: str = ""


@pytest.mark.parametrize(
    "text",
    [
        BOMB,
        b"a: &x [*x]",
        b"[" * 5000,
        b"{a: " * 2000,
        b"- " * 5000,
        b"? " * 5000,
        b"[" * (MAX_DEPTH + 1) + b"]" * (MAX_DEPTH + 1),
        b"[" + b"a," * MAX_NODES + b"]",
        b"#" * (MAX_TEXT_BYTES + 1),
        b"a: " + b"9" * 5000,
        b"1" + b":59" * 15000 + b".5",
        b"when: 2026-13-45",
        b"!!timestamp foo",
        b"!!bool foo",
        b"!!int ''",
        b"!!float {}",
        b"!!python/object/apply:os.system [true]",
        b"? [a]\n: b",
        b"\xff\xff",
        b"a: 1\na: 2",
    ],
)
def test_a_text_that_cannot_be_read_is_one_kind_of_error_in_short_words(text: bytes):
    with pytest.raises(TextError) as caught:
        read_yaml(text)
    assert 0 < len(str(caught.value)) < 1000


def test_what_fits_the_bounds_is_read():
    deep = b"[" * MAX_DEPTH + b"]" * MAX_DEPTH
    assert str(read_yaml(deep)).count("[") == MAX_DEPTH
    assert read_yaml(b"a: 1".ljust(MAX_TEXT_BYTES)) == {"a": 1}


@pytest.mark.parametrize(
    "values",
    [
        {"numbers": [1 << 60000]},
        {"word": 1 << 60000},
        {"numbers": ["x" * 50000] * 500},
        {"word": [["y" * 1000] * 1000] * 10},
        {"k" * 50000: 1, "\ud800": 2},
        {1 << 60000: 1},
    ],
)
def test_faults_are_few_and_short_however_large_what_was_found(values: dict):
    with pytest.raises(ValidationError) as caught:
        Model.model_validate(values)
    lines = explain(Model, caught.value)
    assert 0 < len(lines) <= MAX_FAULTS + 1
    assert max(map(len, lines)) < 1000


def test_the_text_of_an_event_is_cut_and_can_be_written_down():
    event = Event(0, "info", "TABLE_INVALID", "\ud800" + "x" * 10**6)
    assert len(event.text) == MAX_EVENT_TEXT
    assert event.text.startswith("\\ud800x")
    event.text.encode()


@pytest.mark.parametrize("text", [BOMB, b"a: &x [*x]", b"a: &x {b: *x}"])
def test_an_alias_that_expands_without_end_is_refused_where_aliases_are_allowed(text: bytes):
    with pytest.raises(TextError, match="more than"):
        read_yaml(text, aliases=True)


def test_a_configuration_may_have_aliases():
    text = b"a: &x {b: 1}\nc: *x\nd: {<<: *x, e: 2}"
    assert read_yaml(text, aliases=True) == {"a": {"b": 1}, "c": {"b": 1}, "d": {"b": 1, "e": 2}}
    with pytest.raises(TextError, match="line 2"):
        read_yaml(text)


def test_an_alias_without_its_anchor_is_named():
    with pytest.raises(TextError, match="found undefined alias 'joint'"):
        read_yaml(b"joints:\n  - {<<: *joint, name: axis2}\n", aliases=True)
