"""Ages of samples and estimates in telemetry packets, from packets with known times."""

import socket
import time

import pytest

from evidence.speed.link_delay import LinkDelays
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.link.packets import Packetizer

FIELD = {"science": "joint_time_s", "estimate": "estimate_time_s"}


def packet(made: Packetizer, name: str, valid_s: float) -> bytes:
    form = next(p for p in DICTIONARY.packets if p.name == name)
    return made.make(name, 0, {f.name: 0 for f in form.fields} | {FIELD[name]: valid_s})


@pytest.mark.parametrize(("name", "lag_s"), [("science", 0.0), ("estimate", 0.05)])
def test_age_is_that_of_the_first_packet_that_holds_a_time(name: str, lag_s: float):
    """Cut anywhere, with others between; the first time seen may be old already."""
    made, now_s = Packetizer(), time.monotonic()
    other = next(n for n in FIELD if n != name)
    times = [now_s - 100.0, now_s - 2.0 - lag_s, now_s - 2.0 - lag_s, now_s - 1.0 - lag_s]
    sent = b"".join(packet(made, name, t) + packet(made, other, 0.0) for t in times)
    with socket.create_server(("127.0.0.1", 0)) as server:
        delays = LinkDelays(server.getsockname()[1], 0.05)
        link, _ = server.accept()
        with link:
            for k in range(0, len(sent), 100):
                link.sendall(sent[k : k + 100])
            link.shutdown(socket.SHUT_WR)
            delays.join()
        delays.close()
    took_ms = 1e3 * (time.monotonic() - now_s)
    assert 1990.0 <= delays.p99_ms(name) <= 2000.0 + took_ms
    assert delays.p99_ms(other) == 0.0
