"""The operator's end of the authenticated link, written from the frames' layout alone."""

import secrets
import socket
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from fastcrc import crc16

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import Decoder, Telemetry, telecommand_packet

COMMAND_KEY, TELEMETRY_KEY = bytes(range(32)), bytes(range(32, 64))
SPACECRAFT = 42
FILE_ID = 0x1065  # telecommand without secondary header to application 101
FILE_APID = 101
MOST_STEPS = 60  # of 0.2 s until a telecommand must have ended
ENDS = ("completion_success", "completion_failure", "acceptance_failure")


@dataclass(slots=True)
class Numbers:
    """What a ground keeps over a restart of the daemon."""

    following: int = 0  # number of the next frame
    newest: int = -1  # highest IV of an opened frame
    accepted: list[bytes] = field(default_factory=list)  # frames whose telecommand was accepted
    refused: int = 0  # telemetry frames that were authentic and repeated, or not authentic


class GroundEnd:
    """Sends telecommands one by one and follows them; `step` lets the daemon run for 0.2 s."""

    def __init__(self, port: int, numbers: Numbers, step: Callable[[], None]) -> None:
        self.numbers, self._step = numbers, step
        self._socket = socket.create_connection(("127.0.0.1", port), 5.0)
        self._socket.setblocking(False)
        self._buffer = b""
        self._decoder = Decoder()
        self.found: list[Telemetry] = []
        self.units: list[bytes] = []  # of file delivery

    def command(self, name: str, **values: object) -> Mapping[str, int]:
        """Send a telecommand; return the error codes of its reports by name (0: none)."""
        number = self.numbers.following
        packet = telecommand_packet(DICTIONARY.telecommand(name), values, number & 0x3FFF)
        frame = self.send(packet)
        request = int.from_bytes(packet[2:4], "big")
        reports: dict[str, int] = {}
        for _ in range(MOST_STEPS):
            for item in self.look():
                if item.values.get("request_sequence") == request:
                    reports[item.packet.name] = int(item.values.get("error", 0))
                    if item.values.get("error") == Error.REPLAY:  # authentic: it may steer
                        self.numbers.following = int(item.values["error_value"])
                elif item.packet.name == "alive":
                    reports["alive"] = 1
            if any(end in reports for end in ENDS):
                break
        if "acceptance_success" in reports:
            self.numbers.accepted.append(frame)
        return reports

    def send(self, packet: bytes) -> bytes:
        """Seal and send one packet under the next number; return the frame."""
        number, self.numbers.following = self.numbers.following, self.numbers.following + 1
        length = 5 + 2 + 12 + len(packet) + 16 + 2
        head = struct.pack(">HHBH", 1 << 13 | SPACECRAFT, length - 1, 0, 1)
        iv = number.to_bytes(6, "big") + secrets.token_bytes(6)
        masked = SPACECRAFT.to_bytes(2, "big") + bytes(3) + head[5:7] + bytes(12)
        body = head + iv + AESGCM(COMMAND_KEY).encrypt(iv, packet, masked)
        frame = body + crc16.ibm_3740(body).to_bytes(2, "big")
        self._socket.sendall(frame)
        return frame

    def again(self, frame: bytes) -> None:
        """Send a frame that was sent before."""
        self._socket.sendall(frame)

    def unit(self, pdu: bytes) -> None:
        """Send one unit of file delivery."""
        head = struct.pack(">HHH", FILE_ID, 0xC000 | self.numbers.following & 0x3FFF, len(pdu) - 1)
        self.send(head + pdu)

    def look(self) -> list[Telemetry]:
        """Let the daemon run a step; return the packets that it sent."""
        self._step()
        while True:
            try:
                data = self._socket.recv(1 << 20)
            except BlockingIOError:
                break
            if not data:
                break
            self._buffer += data
        found = []
        while len(self._buffer) >= 7:
            length = int.from_bytes(self._buffer[4:6], "big") + 1
            if len(self._buffer) < length:
                break
            frame, self._buffer = self._buffer[:length], self._buffer[length:]
            packet = self._open(frame)
            if packet is None:
                self.numbers.refused += 1
            elif int.from_bytes(packet[:2], "big") & 0x7FF == FILE_APID:
                self.units.append(packet[6:])
            else:
                found.append(self._decoder.decode(packet))
        self.found += found
        return found

    def _open(self, frame: bytes) -> bytes | None:
        """Return the packet of a frame; None if it is not authentic or its number is not new."""
        spi, iv, sealed = frame[7:9], frame[9:21], frame[21:-2]
        masked = (SPACECRAFT << 12).to_bytes(4, "big") + bytes(3) + spi + bytes(12)
        number = int.from_bytes(iv, "big")
        try:
            data = AESGCM(TELEMETRY_KEY).decrypt(iv, sealed, masked)
        except InvalidTag:
            return None
        if number <= self.numbers.newest:
            return None
        self.numbers.newest = number
        return data[1:]

    def close(self) -> None:
        """Disconnect."""
        self._socket.close()
