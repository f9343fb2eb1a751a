"""A stand-in for the daemon's link: telemetry packed by `struct`, reports as a test wants them."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from fastcrc import crc16

from fsw.telemetry.dictionary import DICTIONARY, Type
from tests.support.packing import pack

Reply = Callable[[bytes], Sequence[bytes]]
NO_FAULTS: Mapping[str, int] = {}


def packet(name: str, *, met_s: float = 1.5, **values: Any) -> bytes:
    """Return one packet; what is not given is 0, or empty."""
    definition = DICTIONARY.packet(name)
    match = dict(definition.match)
    full = {
        item.name: values.get(item.name, match.get(item.name, "" if item.type is Type.TEXT else 0))
        for item in definition.fields
    }
    return pack(definition, full, met_s=met_s)


def _outside(at: int, changed: bytes) -> bytes:
    """Return a packet with a right CRC that the dictionary does not have."""
    raw = bytearray(packet("health"))
    raw[at : at + len(changed)] = changed
    body = bytes(raw[:-2])
    return body + crc16.ibm_3740(body).to_bytes(2, "big")


# another APID, service, subtype, housekeeping set; a mode without a name
OUTSIDE = (
    _outside(0, b"\x08\x4d"),
    _outside(7, b"\xc8"),
    _outside(8, b"\x63"),
    _outside(21, b"\x00\x63"),
    _outside(23, b"\xee"),
)


def completed(telecommand: bytes) -> list[bytes]:
    """Return acceptance, start and completion of a telecommand."""
    names = ("acceptance_success", "start_success", "completion_success")
    return [report(name, telecommand) for name in names]


def report(name: str, telecommand: bytes, **values: Any) -> bytes:
    """Return a verification report about a telecommand."""
    words = int.from_bytes(telecommand[:2], "big"), int.from_bytes(telecommand[2:4], "big")
    return packet(name, request_packet_id=words[0], request_sequence=words[1], **values)


class FakeDaemon:
    """Serves clients on a port of its own; `with` ends it."""

    def __init__(
        self,
        reply: Reply = completed,
        stream: Callable[[], bytes] | None = None,
        period_s: float = 0.05,
    ) -> None:
        self._reply, self._stream, self._period_s = reply, stream, period_s
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0.05)
        self.port = self._listener.getsockname()[1]
        self.received = bytearray()
        self.pause = threading.Event()
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> FakeDaemon:
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Close the connection and listen no more."""
        self._stop.set()
        self._thread.join()
        self._listener.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                client, _ = self._listener.accept()
            except TimeoutError:
                continue
            thread = threading.Thread(target=self._serve, args=(client,))
            thread.start()
            self._threads.append(thread)
        for thread in self._threads:
            thread.join()

    def _serve(self, client: socket.socket) -> None:
        with client:
            client.settimeout(self._period_s)
            self._answer(client)

    def _answer(self, client: socket.socket) -> None:
        buffer = bytearray()
        while not self._stop.is_set():
            try:
                if self._stream is not None and not self.pause.is_set():
                    client.sendall(self._stream())
                data = client.recv(65536)
                if not data:
                    return
                self.received += data
                buffer += data
                while len(buffer) >= 6 and len(buffer) >= (
                    length := 7 + int.from_bytes(buffer[4:6], "big")
                ):
                    telecommand = bytes(buffer[:length])
                    del buffer[:length]
                    for answer in self._reply(telecommand):
                        client.sendall(answer)
            except TimeoutError:
                continue
            except ConnectionError:
                return


def run_of_estimates(seed: int = 1, faults: Mapping[str, int] = NO_FAULTS) -> Callable[[], bytes]:
    """Return a maker of telemetry in which the target's mass goes from 300 to 400 kg.

    `faults`: words of the health packet, which may change while the telemetry is made.
    """
    rng = np.random.default_rng(seed)
    begun_s = time.monotonic()

    def make() -> bytes:
        met_s = time.monotonic()
        age_s = met_s - begun_s
        mass_kg = 400.0 - 100.0 * np.exp(-age_s / 10.0) + rng.normal(0.0, 0.5)
        sigma_kg = 1.0 + 40.0 * np.exp(-age_s / 8.0)
        estimate: Mapping[str, Any] = {
            "estimate_time_s": met_s,
            "valid": int(age_s > 5.0),
            "reason": 0 if age_s > 5.0 else 2,
            "method": 5,
            "unknown": 2,
            "blocks": int(age_s * 2.5),
            "nis": float(rng.chisquare(70)),
            "nis_dof": 70,
            "noise_ratio": float(rng.normal(1.0, 0.02)),
            "condition_number": 2e4,
            "whole_present": 1,
            "target_present": 1,
            "target_consistent": 1,
            "target_mass_kg": mass_kg,
            "target_sigma_mass_kg": sigma_kg,
            "target_com_x_m": 0.01,
            "target_com_z_m": 0.52,
        }
        residuals = {f"residual_torque_{k}": abs(rng.normal(0.05, 0.01)) for k in range(1, 8)}
        residuals |= {f"residual_torque_{k}_ratio": rng.normal(1.0, 0.05) for k in range(1, 8)}
        health = packet(
            "health",
            met_s=met_s,
            mode=3,
            ticks=int(age_s * 500),
            work_last_us=float(rng.normal(300, 40)),
            work_mean_us=300.0,
            work_max_us=900.0,
            max_late_us=170.0,
            **faults,
        )
        found = packet("estimate", met_s=met_s, **estimate, **residuals) + health
        if rng.random() < 0.1:
            found += packet(
                "event_low", met_s=met_s, event=3, occurrence=1, text="no right to FIFO"
            )
        return found

    return make
