"""Telecommands that are damaged on the link, or changed and given a correct check value."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from fastcrc import crc16

from evidence.fuzz.choices import Choices
from evidence.fuzz.oracle import require
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.link.packets import telecommand_packet
from fsw.telemetry.link.splitter import CARRIERS, PATIENCE_NS
from fsw.telemetry.link.uplink import ClearUplink

if TYPE_CHECKING:
    from evidence.fuzz.daemon_bench import OperationsBench

HEADER_BYTES, CRC_BYTES, LEAST_BODY_BYTES = 6, 2, 6
PING = telecommand_packet(DICTIONARY.telecommand("PING"), {}, 1)


def damage(packet: bytes, choices: Choices) -> bytes:
    """Return the packet, cut or with damage that the check value always detects."""
    data = bytearray(packet)
    kind = choices.number(3)
    if kind == 0:  # up to three bits, because the distance of the code is four
        for _ in range(1 + choices.number(3)):
            bit = choices.number(8 * len(data))
            data[bit // 8] ^= 1 << (bit % 8)
    elif kind == 1:  # a burst of at most sixteen bits
        at = choices.number(len(data) - 1)
        data[at] ^= 1 + choices.number(255)
        data[at + 1] ^= choices.number(256)
    else:
        del data[1 + choices.number(len(data) - 1) :]
    return bytes(data)


def repair(packet: bytes, choices: Choices) -> bytes:
    """Return the packet with changed bytes after the header, and correct length and check value."""
    body = bytearray(packet[HEADER_BYTES:-CRC_BYTES])
    for _ in range(1 + choices.number(3)):
        kind, at = choices.number(4), choices.number(len(body))
        if kind == 0:
            body[at] = choices.number(256)
        elif kind == 1 and len(body) > LEAST_BODY_BYTES:
            del body[at]
        elif kind == 2:
            body.insert(at, choices.number(256))
        else:
            body += body[at:]
    head = packet[:4] + (len(body) + 1).to_bytes(2, "big")
    whole = head + bytes(body)
    return whole + crc16.ibm_3740(whole).to_bytes(2, "big")


def is_whole(packet: bytes) -> bool:
    """Return whether a packet ends in its check value; one of 65 536 random ends is one."""
    return crc16.ibm_3740(packet[:-CRC_BYTES]) == int.from_bytes(packet[-CRC_BYTES:], "big")


def digest(bench: OperationsBench) -> str:
    """Return the state that telecommands can change, as text."""
    app = bench.app
    state = (
        [app.context.parameter(item.name) for item in DICTIONARY.parameters],
        app.tables.values(),
        app.housekeeping.rates(),
        app.monitoring.table(),
        (app.onboard.digest(), app.monitoring.enabled),
        (app.mode_machine.mode, app.supervision.health.latched, app.times.exponent),
        (bench.counts["forwarded"], app.events.disabled),
    )
    return json.dumps(state, default=str)


def damaged_packet(bench: OperationsBench, packet: bytes, choices: Choices) -> None:
    """Send a damaged packet and then a valid PING; only the PING may be accepted."""
    bad = damage(packet, choices)
    if bad == packet or (len(bad) < len(packet) and is_whole((bad + PING)[: len(packet)])):
        return  # the damage has cancelled itself, or the PING completes what was cut
    before, uplink, now_ns = digest(bench), ClearUplink(), bench.now_ns()
    found = uplink.feed(bad + PING, now_ns)
    while uplink.pending_bytes >= len(PING):
        now_ns += PATIENCE_NS
        found += uplink.expire(now_ns)
    accepted = [i for i in found if i.error is None and not i.is_file and i.packet != PING]
    words = (packet.hex(), bad.hex())
    # a telecommand inside another one is intact; a cut telecommand that carries others is skipped
    # up to its length, so the PING is skipped with it
    carries = any(tuple(data[7:9]) in CARRIERS for data in (packet, bad))
    accepted = [item for item in accepted if not (carries and item.packet in packet[1:])]
    require(not accepted, "a damaged packet was accepted", *words)
    valid = sum(len(item.packet) for item in found if item.packet == PING)
    require(valid or carries, "a valid packet was lost", *words)
    refused = [item for item in found if item.error is not None or item.is_file]
    counters = bench.app.executor.counters
    counts = counters.tc_accepted, counters.tc_rejected + sum(not i.is_file for i in refused)
    for item in refused:
        bench.app.receive(item, bench.now_ns())
    require((counters.tc_accepted, counters.tc_rejected) == counts, "not counted once", *words)
    whole = sum(len(item.packet) for item in found if item.error is None)
    left = uplink.skipped_bytes + uplink.pending_bytes + whole
    require(left == len(bad + PING), "bytes are lost", left, *words)
    require(digest(bench) == before, "a damaged packet had an effect", *words)
    bench.counts["damaged"] += 1


def repaired_packet(bench: OperationsBench, packet: bytes, choices: Choices) -> None:
    """Send a changed packet with a correct check value; a rejection must count once, no more."""
    changed = repair(packet, choices)
    executor = bench.app.executor
    before, events = digest(bench), _rejections(bench)
    accepted, rejected = executor.counters.tc_accepted, executor.counters.tc_rejected
    if executor.receive(changed):
        reset = executor.check(changed).telecommand.name == "RESET_COUNTERS"
        wanted = (0, 0) if reset else (accepted + 1, rejected)
        found = (executor.counters.tc_accepted, executor.counters.tc_rejected)
        require(found == wanted, "accepted and not counted once", changed.hex(), found, wanted)
        bench.counts["repaired_accepted"] += 1
    else:
        require(executor.counters.tc_rejected == rejected + 1, "not counted once", changed.hex())
        require(_rejections(bench) == events + 1, "not reported once", changed.hex())
        require(digest(bench) == before, "a refused packet had an effect", changed.hex())
        bench.counts["repaired_rejected"] += 1
    bench.look()


def _rejections(bench: OperationsBench) -> int:
    """Return the number of rejection events so far, including those held back for a summary."""
    return bench.counts["TC_REJECTED"] + bench.app.context.reporter.summaries.held
