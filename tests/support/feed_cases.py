"""A robot whose joints, inertial unit and star tracker are on one live feed."""

from typing import Any

import numpy as np

from fsw.config import load
from fsw.drivers.sources.feed import FeedSource
from fsw.drivers.wire import ByteChunk
from hil.devices.feed import packed, sealed
from tests.conftest import ArmProject
from tests.support.keys import write_key

MS = 1_000_000
START_NS = 50_000 * MS
SOURCE = 7
RATE_HZ = 250.0
KEY = bytes(range(32))


def on_feed(arm: ArmProject, *, everything: bool = False, **feed: Any) -> ArmProject:
    """Put the joints of an arm on a feed; `everything`: the other sensors too."""
    bus = {"name": "arm", "interface": "samples", "channel": "127.0.0.1", "port": 45454}
    section = {"source": SOURCE} | feed
    if "key_file" in feed:
        write_key(arm.folder / feed["key_file"], KEY)
    arm.data["buses"] = [bus | {"rate_hz": RATE_HZ, "feed": section}]
    for joint in arm.data["joints"]:
        del joint["node_id"]
        joint["driver"] = "samples"
    for key in ("imu", "star_tracker") if everything else ():
        del arm.data[key]["port"]
        arm.data[key] |= {"driver": "samples", "bus": "arm"}
    return arm


def source_of(arm: ArmProject) -> FeedSource:
    config = load(arm.write())
    return FeedSource(config, config.buses[0])


class Sender:
    """Sends joints that turn slowly, on a clock that reads `offset_ns` at START_NS."""

    def __init__(self, *, clock: str = "monotonic", offset_ns: int = START_NS, drift: float = 0.0):
        self.clock, self.offset_ns, self.drift = clock, offset_ns, drift
        self.key: bytes | None = None
        self.sequence = 0

    def reading_ns(self, t_ns: int) -> int:
        return self.offset_ns + round((t_ns - START_NS) / (1.0 + self.drift))

    def bytes_at(self, t_ns: int, **changes: Any) -> bytes:
        """Return the next datagram, valid at a host time and sent 0.2 ms later."""
        angle = 0.1 + 0.05 * (t_ns - START_NS) * 1e-9
        values = changes.pop("values", [angle, -angle, 2 * angle, 1.0, 2.0, 3.0])
        times_ns = self.reading_ns(t_ns), self.reading_ns(t_ns + 200_000)
        source = changes.pop("source", SOURCE)
        times_ns = changes.pop("times_ns", times_ns)
        data = packed(source, self.sequence, times_ns, values, clock=self.clock, **changes)
        self.sequence = (self.sequence + 1) % (1 << 32)
        return data if self.key is None else sealed(data, self.key)

    def stream(self, count: int, first: int = 0, **changes: Any) -> list[ByteChunk]:
        """Return datagrams of `count` periods, each received 0.5 ms after its validity."""
        times_ns = [START_NS + round(k * 1e9 / RATE_HZ) for k in range(first, first + count)]
        return [ByteChunk(t + 500_000, self.bytes_at(t, **dict(changes))) for t in times_ns]


def counts(source: FeedSource, name: str = "arm") -> dict[str, int]:
    """Return the counters that are not zero; require that they add up."""
    own = source.counters[name]
    rejects = sum(n for key, n in own.items() if key.startswith("reject_"))
    assert own["accepted"] + rejects == own["received"]
    assert rejects == own["rejected"]
    assert own["accepted_bytes"] + own["rejected_bytes"] == own["received_bytes"]
    return {key: n for key, n in own.items() if n and "bytes" not in key}


def joint_times_ns(samples: list[Any]) -> np.ndarray:
    """Return the times of validity of the first joint."""
    return np.concatenate([part.t_ns[part.joint == 0] for part in samples])
