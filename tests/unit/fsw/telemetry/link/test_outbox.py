"""Packets that wait for a slow client: order, priorities, what is dropped."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.link.downlink import PRIORITIES
from fsw.telemetry.link.outbox import WIRE_BYTES, Outbox, Priority

SIZE = 100


def packet(kind: Priority, number: int = 0) -> bytes:
    return bytes((int(kind),)) + number.to_bytes(4, "big") + bytes(SIZE - 5)


def sent(outbox: Outbox, most: int = 1 << 30) -> list[tuple[int, int]]:
    """Send so many bytes; return kind and number of every packet."""
    stream = b""
    while len(stream) < most and (data := outbox.next_bytes()):
        part = data[: most - len(stream)]
        outbox.sent(len(part))
        stream += part
    return [
        (stream[at], int.from_bytes(stream[at + 1 : at + 5], "big"))
        for at in range(0, len(stream), SIZE)
    ]


def test_who_keeps_up_gets_everything_in_the_order_it_was_made():
    outbox = Outbox(1 << 16)
    order = [Priority.SCIENCE, Priority.ANSWER, Priority.HEALTH, Priority.SCIENCE]
    for number, kind in enumerate(order):
        outbox.put(packet(kind, number), kind)
    assert sent(outbox) == [(kind, number) for number, kind in enumerate(order)]


def test_who_is_behind_gets_health_events_and_answers_before_science():
    outbox = Outbox(1 << 20)
    for number in range(1000):
        outbox.put(packet(Priority.SCIENCE, number), Priority.SCIENCE)
    sent(outbox, 10 * SIZE)
    outbox.rest()
    for kind in reversed(Priority):
        outbox.put(packet(kind, 5000), kind)
    found = sent(outbox)
    wire = WIRE_BYTES // SIZE + 1 - 10  # was on its way before
    assert [kind for kind, _ in found[wire : wire + 5]] == list(Priority)[:5]
    assert len(found) == 1000 - 10 + 6


def test_a_full_outbox_loses_science_before_anything_else():
    outbox = Outbox(100 * SIZE)
    dropped = [outbox.put(packet(Priority.SCIENCE, k), Priority.SCIENCE) for k in range(150)]
    assert sum(dropped) == 50
    assert outbox.put(packet(Priority.HEALTH), Priority.HEALTH) == 1
    assert outbox.put(packet(Priority.DUMP), Priority.DUMP) == 1
    found = sent(outbox)
    assert len(found) == 100
    assert [number for kind, number in found if kind == Priority.SCIENCE] == list(range(2, 100))
    for _ in range(100):
        assert outbox.put(packet(Priority.HEALTH), Priority.HEALTH) == 0
    assert outbox.put(packet(Priority.SCIENCE), Priority.SCIENCE) == 1


PUTS = st.lists(st.tuples(st.sampled_from(Priority), st.integers(0, 2000)), max_size=60)


@given(PUTS)
def test_every_packet_is_sent_whole_or_dropped_and_counted(puts):
    outbox = Outbox(3000)
    dropped, stream, whole = 0, b"", 0
    for number, (kind, cut) in enumerate(puts):
        dropped += outbox.put(packet(kind, number), kind)
        data = outbox.next_bytes()[:cut]
        whole += outbox.sent(len(data))
        stream += data
        outbox.rest()
    while data := outbox.next_bytes():
        whole += outbox.sent(len(data))
        stream += data
    assert not outbox
    assert len(stream) == SIZE * whole
    assert whole + dropped == len(puts)
    numbers = [int.from_bytes(stream[at + 1 : at + 5], "big") for at in range(0, len(stream), SIZE)]
    assert len(set(numbers)) == whole
    for kind in Priority:
        own = [n for n in numbers if puts[n][0] is kind]
        assert all(a < b for a, b in pairwise(own)), "in order within a priority"


def test_every_packet_of_the_dictionary_has_its_priority():
    assert set(PRIORITIES) == {item.name for item in DICTIONARY.packets}
    assert PRIORITIES["health"] < PRIORITIES["event_high"] < PRIORITIES["alive"]
    assert PRIORITIES["alive"] < PRIORITIES["estimate"] < PRIORITIES["science"]
    assert PRIORITIES["event_log_entry"] > PRIORITIES["health"]
    assert max(PRIORITIES.values()) == PRIORITIES["science"]
