import json
import socket
from pathlib import Path

import pytest

from fsw.errors import PortError
from fsw.messages.commands import Code, Command, Reply
from fsw.service.control import REPLY_TIMEOUT_NS, SOCKET_NAME, ControlServer, control


class Bench:
    def __init__(self, folder: Path) -> None:
        self.commands: list[Command] = []
        self.room = True
        self.path = folder / SOCKET_NAME
        self.server = ControlServer(self.path, lambda: {"ticks": 5}, self.forward)
        self.client = socket.socket(socket.AF_UNIX)
        self.client.settimeout(10.0)
        self.client.connect(str(self.path))

    def forward(self, command: Command) -> bool:
        self.commands.append(command)
        return self.room

    def send(self, data: bytes) -> None:
        self.client.sendall(data)
        for _ in range(3):
            self.server.serve(0.0, 0)

    def answer(self) -> dict:
        return json.loads(self.client.recv(65536))

    def close(self) -> None:
        self.client.close()
        self.server.close()


@pytest.fixture
def bench(tmp_path: Path):
    bench = Bench(tmp_path)
    yield bench
    bench.close()


def test_status_is_answered_at_once(bench: Bench):
    bench.send(b'{"command": "status"}\n')
    answer = bench.answer()
    assert (answer["accepted"], answer["data"]) == (True, {"ticks": 5})
    assert bench.commands == []


def test_a_command_waits_for_the_loop_and_gets_its_reply(bench: Bench):
    bench.send(b'{"comm')
    bench.send(b'and": "reset"}\n')
    (command,) = bench.commands
    text = "reset"
    bench.server.reply(Reply(id=command.id, command=text, accepted=True, code=Code.ACCEPTED))
    assert bench.answer()["code"] == "ACCEPTED"


def test_a_refusal_names_its_reason(bench: Bench):
    bench.send(b"nonsense\n")
    assert bench.answer()["code"] == "MALFORMED"
    bench.room = False
    bench.send(b'{"command": "reset"}\n')
    assert bench.answer()["code"] == "QUEUE_FULL"


def test_a_loop_that_does_not_answer_times_out(bench: Bench):
    bench.send(b'{"command": "reset"}\n')
    bench.server.serve(0.0, REPLY_TIMEOUT_NS + 1)
    assert bench.answer()["code"] == "TIMEOUT"


def test_a_client_that_floods_or_leaves_is_dropped(bench: Bench):
    bench.send(b'{"command": "reset"}\n')
    bench.client.close()
    for _ in range(3):
        bench.server.serve(0.0, 0)
    bench.server.reply(Reply(id=1, command="reset", accepted=True, code=Code.ACCEPTED))
    assert bench.server._clients == 0


def test_no_daemon_is_a_port_error(tmp_path: Path):
    with pytest.raises(PortError, match="no daemon answers"):
        control(tmp_path, {"command": "status"})


def test_a_line_nested_without_end_is_refused_and_the_next_is_answered(bench: Bench):
    bench.send(b"[" * 60_000 + b"\n")
    assert bench.answer()["code"] == "MALFORMED"
    bench.send(b'{"command": "status"}\n')
    assert bench.answer()["accepted"]


def test_an_error_nobody_foresaw_is_answered(bench: Bench):
    def unforeseen(_command: Command) -> bool:
        raise RuntimeError("no pickle of that")

    bench.server._forward = unforeseen
    bench.send(b'{"command": "reset"}\n')
    answer = bench.answer()
    assert (answer["code"], "no pickle" in answer["text"]) == ("FAILED", True)
    bench.send(b'{"command": "status"}\n')
    assert bench.answer()["accepted"]
