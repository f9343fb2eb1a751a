"""The local control socket: one JSON line per command and per reply. Server and client."""

import json
import os
import selectors
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fsw.errors import CommandError, PortError, unforeseen
from fsw.messages.commands import MAX_LINE_BYTES, Code, Command, CommandName, Reply, parse_command

SOCKET_NAME = "ctl.sock"
MAX_CLIENTS = 16
REPLY_TIMEOUT_NS = 5_000_000_000


@dataclass(slots=True)
class _Client:
    connection: socket.socket
    buffer: bytearray = field(default_factory=bytearray)


class ControlServer:
    """Serves clients on a UNIX socket without blocking.

    Parameters
    ----------
    path : socket file; an old one is replaced
    status : returns the newest status, the answer to the command `status`
    forward : passes every other command on; returns False if there is no room for it
    """

    def __init__(
        self,
        path: Path,
        status: Callable[[], Mapping[str, Any]],
        forward: Callable[[Command], bool],
    ) -> None:
        self._status, self._forward = status, forward
        self._path = path
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.setblocking(False)
        try:
            path.unlink(missing_ok=True)
            self._listener.bind(str(path))
            path.chmod(0o600)
            self._listener.listen(MAX_CLIENTS)
            self._inode = path.stat().st_ino
        except OSError as error:
            self._listener.close()
            raise PortError(f"{path}: {error.strerror or error}") from error
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._waiting: dict[int, tuple[int, _Client]] = {}
        self._clients = 0
        self._next_id = 1

    @property
    def is_removed(self) -> bool:
        """Whether the socket file is no longer there, so that no client can connect."""
        try:
            return self._path.stat().st_ino != self._inode
        except (FileNotFoundError, NotADirectoryError):
            return True
        except OSError:
            return False

    def serve(self, timeout_s: float, now_ns: int) -> None:
        """Wait at most `timeout_s` [s] for clients and serve them; time out missing replies."""
        for key, _ in self._selector.select(timeout_s):
            if key.data is None:
                self._accept()
            else:
                self._read(key.data, now_ns)
        late = [i for i, (since, _) in self._waiting.items() if now_ns - since > REPLY_TIMEOUT_NS]
        for number in late:
            text = "the loop did not answer"
            self.reply(Reply(id=number, command="", accepted=False, code=Code.TIMEOUT, text=text))

    def reply(self, reply: Reply) -> None:
        """Send a reply to the client that waits for it, if there is one."""
        _, client = self._waiting.pop(reply.id, (0, None))
        if client is not None:
            self._send(client, reply_values(reply))

    def close(self) -> None:
        """Disconnect all clients and remove the socket file."""
        for key in list(self._selector.get_map().values()):
            if key.data is not None:
                self._drop(key.data)
        self._selector.close()
        self._listener.close()
        if not self.is_removed:
            with suppress(OSError):
                self._path.unlink()

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:
            return
        if self._clients >= MAX_CLIENTS:
            connection.close()
            return
        connection.setblocking(False)
        self._clients += 1
        self._selector.register(connection, selectors.EVENT_READ, _Client(connection))

    def _read(self, client: _Client, now_ns: int) -> None:
        try:
            data = client.connection.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        client.buffer += data
        if not data or len(client.buffer) > 2 * MAX_LINE_BYTES:
            self._drop(client)
            return
        while (end := client.buffer.find(b"\n")) >= 0:
            line = bytes(client.buffer[:end])
            del client.buffer[: end + 1]
            self._answer(client, line, now_ns)

    def _answer(self, client: _Client, line: bytes, now_ns: int) -> None:
        number, self._next_id = self._next_id, self._next_id + 1
        try:
            command = parse_command(line, number)
        except CommandError as error:
            refusal = Reply(
                id=number, command="", accepted=False, code=Code(error.code), text=str(error)
            )
            self._send(client, reply_values(refusal))
            return
        try:
            self._carry_out(client, command, now_ns)
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - no command ends the service
            name, text = str(command.name), unforeseen(error)
            self._waiting.pop(number, None)
            failed = Reply(id=number, command=name, accepted=False, code=Code.FAILED, text=text)
            self._send(client, reply_values(failed))

    def _carry_out(self, client: _Client, command: Command, now_ns: int) -> None:
        number = command.id
        if command.name is CommandName.STATUS:
            answer = Reply(
                id=number,
                command="status",
                accepted=True,
                code=Code.ACCEPTED,
                data=self._status(),
            )
            self._send(client, reply_values(answer))
            return
        self._waiting[number] = (now_ns, client)
        if not self._forward(command):
            self.reply(refused(command))

    def _send(self, client: _Client, values: Mapping[str, Any]) -> None:
        try:
            client.connection.send(json.dumps(values).encode() + b"\n")
        except OSError:
            self._drop(client)

    def _drop(self, client: _Client) -> None:
        if client.connection.fileno() < 0:
            return
        self._selector.unregister(client.connection)
        client.connection.close()
        self._clients -= 1
        self._waiting = {i: item for i, item in self._waiting.items() if item[1] is not client}


def refused(command: Command) -> Reply:
    """Return the reply to a command that found no room in the ring to the loop."""
    text = "the ring to the loop is full"
    name = str(command.name)
    return Reply(id=command.id, command=name, accepted=False, code=Code.QUEUE_FULL, text=text)


def reply_values(reply: Reply) -> dict[str, Any]:
    """Return a reply as plain values."""
    return {
        "id": reply.id,
        "command": reply.command,
        "accepted": reply.accepted,
        "code": str(reply.code),
        "text": reply.text,
        "data": dict(reply.data),
    }


def control(
    state_directory: Path, request: Mapping[str, Any], timeout_s: float = 10.0
) -> dict[str, Any]:
    """Send one command to a running daemon and return its reply.

    Raises
    ------
    PortError when no daemon answers there.
    """
    path = state_directory / SOCKET_NAME
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
            link.settimeout(timeout_s)
            link.connect(os.fspath(path))
            link.sendall(json.dumps(request).encode() + b"\n")
            with link.makefile("rb") as answers:
                line = answers.readline()
    except OSError as error:
        raise PortError(
            f"{path}: no daemon answers; fsw run CONFIG starts one: {error.strerror or error}"
        ) from error
    if not line:
        raise PortError(f"{path}: the daemon closed the connection")
    reply: dict[str, Any] = json.loads(line)
    return reply
