"""Whether a packet says what the daemon's own log says, bit by bit; one check a kind."""

import json
import shutil
import time
import zlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fsw.telemetry.dictionary import DICTIONARY, dictionary_crc32
from fsw.telemetry.dictionary.housekeeping import REASONS
from fsw.telemetry.state.version import version_values
from ground.telemetry import Sample
from tests.support.daemon_log import DaemonLog
from tests.support.onboard_checks import ONBOARD_CHECKS, Values, holds

AXES = ("x", "y", "z")
PAIRS = ("xx", "xy", "xz", "yy", "yz", "zz")
COUNTS = ("received", "accepted", "lost", "late", "rejected", *(f"reject_{r}" for r in REASONS))
TIMES = ("last", "mean", "max")
NEVER_SENT = {"start_failure", "progress_failure"}  # nothing fails there
TC_PACKET_ID = 0x1864  # telecommand with secondary header to application 100


def single(value: float) -> float:
    """The nearest number of 32 bits."""
    return float(np.float32(value))


def body(prefix: str, mean: Values, sigma: Values) -> dict[str, float]:
    """The fields of a body from logged values."""
    fields = {}
    for start, source in ((prefix, mean), (f"{prefix}_sigma", sigma)):
        fields[f"{start}_mass_kg"] = source["mass_kg"]
        fields |= {f"{start}_com_{a}_m": x for a, x in zip(AXES, source["com_m"], strict=True)}
        inertia = zip(PAIRS, source["inertia_kg_m2"], strict=True)
        fields |= {f"{start}_inertia_{pair}_kg_m2": x for pair, x in inertia}
    return fields


def is_health(sample: Sample, log: DaemonLog) -> bool:
    values = sample.values
    first = {"boot_count": 1, "config_crc32": log.config.crc32, "reset_cause": "FIRST_START"}
    if values["mode"] == "BOOT":
        return holds(values, first)
    summary = log.by_ticks[values["ticks"]]
    counts = {f"windows_{name}": count for name, count in summary["windows"].items()}
    ring = {f"ring_{name}": count for name, count in summary["ring"].items()}
    delays = {name: summary[f"{name}_us"] for name in ("sampled", "published")}
    times = {"work": summary["work_us"], **summary["tasks_us"], **delays}
    spent = {
        f"{name}_{kind}_us": single(times[name][kind])
        for name in ("work", "drain", "hand_over", "sampled", "published")
        for kind in TIMES
    }
    more = {"slips": summary["slips"], "max_late_us": single(summary["max_late_us"])}
    return holds(values, first | counts | ring | spent | more)


def is_estimate(sample: Sample, log: DaemonLog) -> bool:
    if sample.values["reason"] == "NO_ESTIMATE":
        return sample.values["blocks"] == 0
    return any(_is(sample.values, e) for e in log.estimates[sample.values["estimate_time_s"]])


def _is(values: Values, logged: Values) -> bool:
    named = dict(zip(logged["names"], logged["mean"], strict=True))
    keys = ("blocks", "gated", "nis", "nis_dof", "condition_number", "information_gained_nats")
    expected = {key: logged[key] for key in keys if logged[key] is not None}  # no infinity in JSON
    expected |= {"valid": "YES" if logged["valid"] else "NO", "method": logged["method"].upper()}
    expected["reason"] = "VALID" if logged["valid"] else logged["reason"].upper()
    for name, mean in logged["estimate"].items():
        expected |= body(name, mean, logged["sigma"][name])
        consistent = logged["physically_consistent"][name]
        expected[f"{name}_consistent"] = "YES" if consistent else "NO"
    for axis in AXES:
        expected[f"acc_bias_{axis}_m_s2"] = named[f"acc_bias.{axis}"]
        expected[f"gyro_bias_{axis}_rad_s"] = named[f"gyro_bias.{axis}"]
    offsets = [value for name, value in named.items() if name.startswith("torque_offset.")]
    expected |= {f"torque_offset_{k}": value for k, value in enumerate(offsets, start=1)}
    return holds(values, expected)


def is_covariance(sample: Sample, log: DaemonLog) -> bool:
    values = sample.values
    cells = [name for name in values if name.startswith("cov_")]
    if values["target_present"] == "NO":
        return not any(values[name] for name in cells)
    return any(
        holds(values, {name: _cell(name, logged) for name in cells})
        for logged in log.estimates[values["estimate_time_s"]]
    )


def _cell(name: str, logged: Values) -> float:
    places = []
    words = name.removeprefix("cov_").split("_")
    for state in (".".join(words[:2]), ".".join(words[2:])):
        if state not in logged["names"]:
            return 0.0
        places.append(logged["names"].index(state))
    return float(logged["covariance"][places[0]][places[1]])


def is_devices(sample: Sample, log: DaemonLog) -> bool:
    (bus,) = (bus.name for bus in log.config.buses)
    slots = {"bus1": bus, "imu": "imu", "star_tracker": "star_tracker"}
    if not sample.values["imu_received"]:
        return True  # before the first summary
    return any(holds(sample.values, _counters(slots, summary, log)) for summary in log.summaries)


def _counters(slots: Mapping[str, str], summary: Values, log: DaemonLog) -> dict[str, Any]:
    expected: dict[str, Any] = {}
    for slot, name in slots.items():
        samples, link = summary["samples"][name], summary["links"][name]
        expected[f"{slot}_up"] = "YES" if link["up"] else "NO"
        expected[f"{slot}_losses"] = link["losses"]
        for key in COUNTS:
            expected[f"{slot}_{key}"] = samples.get(key, 0)
    for k, joint in enumerate(log.config.joints, start=1):
        expected[f"joint_{k}_motor_present"] = "YES" if joint.name in summary["joints"] else "NO"
    return expected


def is_science(sample: Sample, log: DaemonLog) -> bool:
    values = sample.values
    joints = [
        (f"joint_{k}", (values[f"joint_{k}_position"], values[f"joint_{k}_torque"]))
        for k in range(1, len(log.config.joints) + 1)
    ]
    found = {
        "joint_time": (values["joint_time_s"],),
        "gyro": (values["gyro_time_s"], *(values[f"gyro_{a}_rad_s"] for a in AXES)),
        "acc": (values["acc_time_s"], *(values[f"specific_force_{a}_m_s2"] for a in AXES)),
        "attitude": (values["attitude_time_s"], *(values[f"attitude_{a}"] for a in "xyzw")),
        **dict(joints),
    }
    return all(item in log.samples[name] or not any(item) for name, item in found.items())


def is_batch(sample: Sample, log: DaemonLog) -> bool:
    values = sample.values
    jobs = [summary["job"] for summary in log.summaries if summary["job"]]
    if values["state"] in ("NONE", "RUNNING"):
        return values["job_id"] in {0, *(job["id"] for job in jobs)}
    for job in jobs:
        result = job["result"] or {}
        if job["id"] != values["job_id"] or job["state"].upper() != values["state"]:
            continue
        numbers = ("cost", "condition_number", "duration_s")
        expected = {key: result.get(key, 0.0) for key in numbers}
        for name, mean in result["estimate"].items():
            expected |= body(name, mean, result["sigma"][name])
        if holds(values, expected | {"result_status": result["status"]}):
            return True
    return False


def is_tables(sample: Sample, log: DaemonLog) -> bool:
    for name, generations in log.tables.items():
        number = sample.values[f"{name}_generation"]
        content = next((g.content for g in generations if g.number == number), b"")
        if sample.values[f"{name}_active_crc32"] != zlib.crc32(content):
            return False
    return True


def is_recorder(sample: Sample, log: DaemonLog) -> bool:
    values, path = sample.values, log.recordings[0]
    named = {"recording": "YES", "file": path.name, "recordings": 1, "failed_messages": 0}
    return holds(values, named) and 0 <= values["file_bytes"] <= path.stat().st_size


def is_link(sample: Sample, log: DaemonLog) -> bool:
    final, values = log.final["telemetry"]["link"], sample.values
    counts = ("tm_packets", "tc_bytes", "tc_garbage_bytes", "tc_resyncs", "tm_bytes")
    same = {"boot_count": 1, "tc_security": "NONE", "udp_packets": 0, "sdls_accepted": 0}
    return holds(values, same) and all(values[key] <= final[key] for key in counts)


def says(values: Values, event: Values) -> bool:
    """Whether a report tells a logged event; a code without a number goes at the text's head."""
    if values["event"] == "OTHER":
        return f"{event['code']}: {event['text']}".startswith(values["text"])
    return event["code"] == values["event"] and event["text"].startswith(values["text"])


def is_event(sample: Sample, log: DaemonLog) -> bool:
    values, severity = sample.values, sample.packet.removeprefix("event_")
    for event in log.events:
        time_s = (event["t_ns"] * 2**24 // 10**9) / 2**24
        if event["severity"] == severity and time_s == sample.time_s and says(values, event):
            return True
    return False


def is_log_entry(sample: Sample, log: DaemonLog) -> bool:
    found = sample.values
    return any(
        event["t_ns"] * 1e-9 == found["time_s"]
        and event["severity"].upper() == found["severity"]
        and says(found, event)
        for event in log.events
    )


def is_report(sample: Sample, log: DaemonLog) -> bool:
    """A verification report; of what failed, an event of the same time says the same."""
    values = sample.values
    if values["request_packet_id"] != TC_PACKET_ID:
        return sample.packet == "routing_failure" and values["error"] == "WRONG_APID"
    told = ("TC_REJECTED", "TC_FAILED")
    return "error" not in values or any(
        event["code"] in told and values["error"] in event["text"] for event in log.events
    )


def is_parameter(sample: Sample, log: DaemonLog) -> bool:
    ((name, value),) = ((k, v) for k, v in sample.values.items() if k != "parameter")
    item = next(item for item in DICTIONARY.parameters if item.name == name)
    configured = getattr(log.config.estimator, name, item.default) or 0.0
    return value in {configured, *(kept[name] for kept in log.parameters if name in kept)}


def is_version(sample: Sample, log: DaemonLog) -> bool:
    crc32 = {"config_crc32": log.config.crc32, "dictionary_crc32": dictionary_crc32()}
    return holds(sample.values, version_values() | {"boot_count": 1} | crc32)


def is_file(sample: Sample, log: DaemonLog) -> bool:
    values, path = sample.values, log.file(str(sample.values["path"]))
    if values.get("kind", "FILE") != "FILE":
        return path.is_dir() and values["kind"] == "FOLDER" and values["size_bytes"] == 0
    expected: dict[str, Any] = {"size_bytes": path.stat().st_size}
    if "crc32" in values:
        expected["crc32"] = zlib.crc32(path.read_bytes())
    if "modified_s" in values:
        expected["modified_s"] = path.stat().st_mtime
    return holds(values, expected)


def is_transfer(sample: Sample, _log: DaemonLog) -> bool:
    """Nothing is under way when the tour asks."""
    return all(value in (0, "", "NONE") for value in sample.values.values())


def is_space(sample: Sample, log: DaemonLog) -> bool:
    total = shutil.disk_usage(log.file(str(sample.values["path"]))).total
    return sample.values["total_bytes"] == total >= int(sample.values["free_bytes"]) > 0


def is_dumped(sample: Sample, log: DaemonLog) -> bool:
    content = log.file(str(sample.values["path"])).read_bytes()
    expected = {"size_bytes": len(content), "crc32": zlib.crc32(content)}
    return holds(sample.values, expected)


def is_diagnosis(sample: Sample, log: DaemonLog) -> bool:
    blocks = {e["blocks"] for same in log.estimates.values() for e in same}
    return sample.values["blocks"] in blocks


def is_transition(sample: Sample, log: DaemonLog) -> bool:
    values = sample.values
    words = f"monitor {values['monitor']}: {values['value']} {values['now']}, {values['found']:.6g}"
    return any(event["text"] == words for event in log.events)


def is_schedule(sample: Sample, log: DaemonLog) -> bool:
    return holds(sample.values, log.kept["schedule"] | {"n": 1})


def is_definition(sample: Sample, log: DaemonLog) -> bool:
    (config,) = json.loads(log.tables["monitors"][0].content)["monitors"]
    same = ("value", "low", "repetitions", "stale_s", "action")
    largest = float(np.finfo(np.float64).max)  # no limit on this side
    expected = {"monitor": config["id"], "enabled": "ENABLED", "high": largest}
    return holds(sample.values, expected | {name: config[name] for name in same})


def is_status(sample: Sample, log: DaemonLog) -> bool:
    (config,) = json.loads(log.tables["monitors"][0].content)["monitors"]
    told = sample.values["status"] in ("UNCHECKED", "BELOW_LOW")
    return told and holds(sample.values, {"monitor": config["id"], "enabled": "ENABLED"})


def is_properties(sample: Sample, log: DaemonLog) -> bool:
    interval_ms = round(1e3 * log.config.telemetry.housekeeping_interval_s)
    return holds(sample.values, {"sid": "HEALTH", "periodic": "YES", "interval_ms": interval_ms})


def is_disabled(sample: Sample, _log: DaemonLog) -> bool:
    rest = {f"event_{k}": "NONE" for k in range(2, 17)}
    return holds(sample.values, {"n": 1, "event_1": "BATCH_DONE", **rest})


def is_time(sample: Sample, log: DaemonLog) -> bool:
    first_s, last_s = (log.events[k]["t_ns"] * 1e-9 for k in (0, -1))
    return first_s - 1.0 <= sample.time_s <= last_s + 1.0


def is_correlation(sample: Sample, log: DaemonLog) -> bool:
    """UTC is that of this machine, whose clock the daemon reads too."""
    values = sample.values
    apart_s = values["utc_unix_ns"] * 1e-9 - sample.time_s - (time.time() - time.monotonic())
    steered = values["synchronised"] == "YES" or values["uncertainty_s"] > 10.0
    return is_time(sample, log) and steered and abs(apart_s) < 1.0


CHECKS: dict[str, Callable[[Sample, DaemonLog], bool]] = {
    "health": is_health,
    "estimate": is_estimate,
    "covariance": is_covariance,
    "devices": is_devices,
    "batch": is_batch,
    "tables": is_tables,
    "recorder": is_recorder,
    "link": is_link,
    "science": is_science,
    "time": is_time,
    "alive": is_time,
    "time_correlation": is_correlation,
    "schedule_entry": is_schedule,
    **ONBOARD_CHECKS,
    "monitor_definition": is_definition,
    "monitor_status": is_status,
    "set_properties": is_properties,
    "disabled_events": is_disabled,
    "version": is_version,
    "diagnosis": is_diagnosis,
    "event_log_entry": is_log_entry,
    "table_dumped": is_dumped,
    "check_transition": is_transition,
    "file_attributes": is_file,
    "file_entry": is_file,
    "transfer_status": is_transfer,
    "file_space": is_space,
    **{f"event_{severity}": is_event for severity in ("info", "low", "medium", "high")},
    **{p.name: is_report for p in DICTIONARY.packets if p.service == 1},
    **{p.name: is_parameter for p in DICTIONARY.packets if p.service == 20},
}
