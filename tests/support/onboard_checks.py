"""Checks of packets about what is kept on board: sequences, stores, event actions, commands."""

import zlib
from collections.abc import Callable, Mapping
from typing import Any

from fsw.telemetry.dictionary import DICTIONARY
from ground.telemetry import Sample
from tests.support.daemon_log import DaemonLog

Values = Mapping[str, Any]


def holds(found: Values, expected: Values) -> bool:
    return all(found[name] == value for name, value in expected.items())


def is_detail(sample: Sample, log: DaemonLog) -> bool:
    release_s, request = log.kept["schedule"]["release_time_s"], log.kept["scheduled"]
    expected = {"n": 1, "release_time_s": release_s}
    return holds(sample.values, expected) and carries(sample.values, request)


def carries(values: Values, request: bytes) -> bool:
    return bytes.fromhex(str(values["request_hex"])) == request


def is_sequence(sample: Sample, log: DaemonLog) -> bool:
    """A report on the one sequence: its content, or its state after its first entry."""
    content = log.kept["sequence"]
    expected: dict[str, Mapping[str, Any]] = {
        "sequence_status": {"n": 1, "status": "EXECUTING", "entries": 2},
        "sequence_checked": {"crc32": zlib.crc32(content), "size_bytes": len(content)},
        "sequence_entry": {"n": 2, "delay_ms": int.from_bytes(content[-4:], "big")},
        "sequence_aborted": {"n": 1},
    }
    if not holds(sample.values, {"sequence": 1, **expected[sample.packet]}):
        return False
    if sample.packet == "sequence_status":
        return sample.values["released"] in (0, 1)  # the first entry is released at the next poll
    return sample.packet != "sequence_entry" or carries(sample.values, log.kept["request"])


def is_event_action(sample: Sample, log: DaemonLog) -> bool:
    named = {"n": 1, "apid": 100, "event": "STOPPED", "enabled": "DISABLED"}
    if sample.packet == "event_action":
        return holds(sample.values, named) and carries(sample.values, log.kept["request"])
    return holds(sample.values, named | {"function_enabled": "ENABLED", "released": 0})


def is_store(sample: Sample, log: DaemonLog) -> bool:
    values = sample.values
    if sample.packet == "store_status":
        return holds(values, {"n": 1, "enabled": "ENABLED", "playing_back": "NO"})
    first_s = min(event["t_ns"] for event in log.events) * 1e-9
    in_order = first_s - 1.0 <= values["oldest_s"] <= values["newest_s"] <= sample.time_s
    filled = 0 < values["stored_bytes"] <= values["size_bytes"]
    return in_order and filled and holds(values, {"n": 1, "store": "EVENTS"})


def is_checked(sample: Sample, log: DaemonLog) -> bool:
    content = log.file("files/tour.bin").read_bytes()
    expected = {"memory": "FILES", "base": "files/tour.bin", "offset": 0}
    return holds(sample.values, expected | {"length": len(content), "crc32": zlib.crc32(content)})


def is_logged_command(sample: Sample, log: DaemonLog) -> bool:
    """As the journal of commands has it at the end; its outcome may have come afterwards."""
    values = sample.values
    return any(
        values["time_s"] == found["time_s"]
        and values["command"] == found["name"]
        and values["outcome"] in ("ACCEPTED", found["outcome"])
        and found["who"].startswith(values["who"])
        and found["arguments"].startswith(values["arguments"])
        for found in log.commands
    )


ONBOARD_CHECKS: dict[str, Callable[[Sample, DaemonLog], bool]] = {
    "schedule_detail": is_detail,
    **{p.name: is_sequence for p in DICTIONARY.packets if p.service == 21},
    **{p.name: is_event_action for p in DICTIONARY.packets if p.service == 19},
    **{p.name: is_store for p in DICTIONARY.packets if p.service == 15},
    "object_checked": is_checked,
    "command_log_entry": is_logged_command,
}
