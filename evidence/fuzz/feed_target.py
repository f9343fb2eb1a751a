"""Target of the live feed: datagrams of every kind, with and without a key."""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import yaml

from evidence.fuzz.oracle import Target, chunks, require
from evidence.fuzz.serial_targets import MOUNTING
from evidence.fuzz.text_targets import CORRECT
from fsw.config import Config, parse
from fsw.drivers.sources import FeedSource
from fsw.drivers.wire import ByteChunk
from fsw.messages import ImuSamples, Samples
from hil.devices.feed import CLOCKS, KINDS, packed, sealed

MS = 1_000_000
START_NS = 10**12
SOURCE = 7
KEY = bytes(range(32))
MOST_FINDINGS = 4 * 1024
WIDTHS = {"joints": 2, "imu": 6, "attitude": 4}


def config_of(clock: str, key_file: Path | None) -> Config:
    """Return the configuration of a robot whose sensors are all on one feed."""
    document = yaml.safe_load(CORRECT)
    feed = {"source": SOURCE, "clock": clock, "key_file": key_file and str(key_file)}
    bus = {"name": "arm", "interface": "samples", "rate_hz": 250.0, "feed": feed}
    document["buses"] = [bus]
    del document["joints"][0]["node_id"], document["imu"]["port"]
    for section in (document["joints"][0], document["imu"]):
        section |= {"driver": "samples", "bus": "arm"}
    document["star_tracker"] = {
        "driver": "samples",
        "bus": "arm",
        "rate_hz": 5.0,
        "mounting": MOUNTING,
        "latency_s": 0.1,
        "noise_across_rad": 1e-5,
        "noise_about_rad": 5e-5,
    }
    return parse(yaml.safe_dump(document).encode(), Path("/nowhere"), "fuzz")


def seal(payload: bytes, *, key: bytes | None, clock: str) -> bytes:
    """Return a datagram: kind and clock, sequence, ages of its times [ms], values in tenths."""
    choice, number, valid, sent, *values = payload.ljust(4, b"\0")
    kind = list(KINDS)[choice % 3]
    named = clock if choice < 128 else list(CLOCKS)[choice % 4]
    width = WIDTHS[kind] + (choice >> 4 & 1)
    tenths = [value / 10.0 - 12.0 for value in values[:width]]
    tenths += [0.1] * (width - len(tenths))
    times_ns = START_NS + valid * MS - 128 * MS, START_NS + sent * MS - 128 * MS
    data = packed(SOURCE, number << 24 | number, times_ns, tenths, kind=kind, clock=named)
    return data if key is None else sealed(data, key)


def check(source: FeedSource, given: list[ByteChunk], sizes: list[int]) -> list[list[float]]:
    """Feed datagrams in batches; check counters, times and findings; return all samples."""
    found, at = [], 0
    for size in sizes:
        for samples in source.feed(given[at : at + size]):
            found += rows(samples)
        at += size
        counted = source.counters
        received = sum(own["received_bytes"] for own in counted.values())
        require(received == sum(len(c.data) for c in given[:at]), "bytes are lost", counted)
        for own in counted.values():
            rejects = sum(n for name, n in own.items() if name.startswith("reject_"))
            require(rejects == own["rejected"], "rejects do not add up", own)
            require(own["accepted"] + rejects == own["received"], "samples do not add up", own)
            both = own["accepted_bytes"] + own["rejected_bytes"]
            require(both == own["received_bytes"], "bytes do not add up", own)
            require(min(own.values()) >= 0, "a counter is negative", own)
        require(len(source.findings()) <= MOST_FINDINGS, "findings grow")
    return found


def rows(samples: Samples) -> list[list[float]]:
    """Return samples as rows of numbers; require that none is valid after its receipt."""
    times_ns = samples.t_gyro_ns if isinstance(samples, ImuSamples) else samples.t_ns
    require((times_ns <= samples.t_receive_ns).all(), "valid after it was received", samples)
    columns = [np.atleast_2d(np.asarray(getattr(samples, n), float).T) for n in samples.__slots__]
    found: list[list[float]] = np.concatenate(columns).T.tolist()
    return found


def feed_target() -> Target:
    """Return the target of the live feed."""
    key_file = Path(tempfile.mkdtemp()) / "key"
    key_file.write_bytes(KEY)
    key_file.chmod(0o600)
    cases: list[tuple[str, bytes | None]] = [("monotonic", None), ("device", None), ("unix", KEY)]
    configs = [config_of(clock, key_file if key else None) for clock, key in cases]

    def one(data: bytes) -> None:
        for config, (clock, key) in zip(configs, cases, strict=True):
            pieces = chunks(data, partial(seal, key=key, clock=clock))
            given = [ByteChunk(START_NS + k * MS, piece) for k, piece in enumerate(pieces)]
            whole = check(FeedSource(config, config.buses[0]), given, [len(given)])
            single = check(FeedSource(config, config.buses[0]), given, [1] * len(given))
            same = sorted(map(str, whole)) == sorted(map(str, single))
            require(same, "samples depend on batches", whole, single)

    return one
