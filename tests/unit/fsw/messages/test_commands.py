import pytest

from fsw.errors import CommandError
from fsw.messages.commands import Code, CommandName, parse_command


def refusal(line: bytes) -> str:
    with pytest.raises(CommandError) as caught:
        parse_command(line, 1)
    return caught.value.code


def test_a_command_is_a_json_object_with_its_name():
    command = parse_command(b'{"command": "reset"}', 7)
    assert (command.name, command.id, command.args) == (CommandName.RESET, 7, {})


def test_a_batch_names_method_bodies_and_span():
    line = b'{"command": "run-batch", "method": "rda", "unknown": "both", "last_s": 30}'
    command = parse_command(line, 1)
    assert command.args == {"method": "rda", "unknown": ["base", "target"], "last_s": 30}


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b"", Code.MALFORMED),
        (b"\xff\xfe", Code.MALFORMED),
        (b"[1]", Code.MALFORMED),
        (b"{}", Code.MALFORMED),
        (b'{"command": 3}', Code.MALFORMED),
        (b'{"command": "explode"}', Code.UNKNOWN_COMMAND),
        (b'{"command": "reset", "now": true}', Code.BAD_ARGUMENT),
        (b'{"command": "run_batch"}', Code.BAD_ARGUMENT),
        (b'{"command": "run_batch", "method": "magic"}', Code.BAD_ARGUMENT),
        (b'{"command": "run_batch", "method": "rda", "unknown": "an arm"}', Code.BAD_ARGUMENT),
        (b'{"command": "run_batch", "method": "rda", "last_s": -1}', Code.BAD_ARGUMENT),
        (b'{"command": "run_batch", "method": "rda", "last_s": true}', Code.BAD_ARGUMENT),
        (b'{"command": "run_batch", "method": "rda", "last_s": Infinity}', Code.BAD_ARGUMENT),
        (b'{"command": "run_batch", "method": "rda", "last_s": 1e999}', Code.BAD_ARGUMENT),
        (b'{"command": "run_batch", "method": "rda", "last_s": NaN}', Code.BAD_ARGUMENT),
        (b'{"command": "run_batch", "method": "rda", "last_s": 1000001}', Code.BAD_ARGUMENT),
        (b'{"command": "run_batch", "method": "rda", "colour": 1}', Code.BAD_ARGUMENT),
        (b'{"command": "run_plan", "duration_s": 0}', Code.BAD_ARGUMENT),
        (b'{"command": "run_plan", "duration_s": NaN}', Code.BAD_ARGUMENT),
        (b'{"command": "run_plan", "duration_s": 1e999}', Code.BAD_ARGUMENT),
        (b'{"command": "run_plan", "duration_s": "long"}', Code.BAD_ARGUMENT),
        (b'{"command": "run_plan", "starts": 0}', Code.BAD_ARGUMENT),
        (b'{"command": "run_plan", "starts": 1.5}', Code.BAD_ARGUMENT),
        (b'{"command": "run_plan", "starts": true}', Code.BAD_ARGUMENT),
        (b'{"command": "run_plan", "seed": -1}', Code.BAD_ARGUMENT),
        (b'{"command": "run_plan", "seed": [[]]}', Code.BAD_ARGUMENT),
        (b'{"command": "run_plan", "limits": "wider.yaml"}', Code.BAD_ARGUMENT),
        (b" " * 70_000, Code.MALFORMED),
        (b"[" * 60_000, Code.MALFORMED),
        (b'{"command":' * 5_000, Code.MALFORMED),
        (b'{"command": "reset", "now": ' + b"9" * 5_000 + b"}", Code.MALFORMED),
        (
            b'{"command": "configure", "unknown": ' + b"[" * 400 + b"]" * 400 + b"}",
            Code.BAD_ARGUMENT,
        ),
    ],
)
def test_what_is_not_understood_is_refused_with_a_reason(line: bytes, code: Code):
    assert refusal(line) == code


def test_a_refusal_is_short_however_long_the_line():
    keys = ", ".join(f'"key{k}": 1' for k in range(4000))
    for line in (f'{{"command": "reset", {keys}}}', f'{{"command": "{"x" * 60_000}"}}'):
        with pytest.raises(CommandError) as caught:
            parse_command(line.encode(), 1)
        assert len(str(caught.value)) < 1000
