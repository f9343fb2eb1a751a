"""Traffic of a bus with faults of every kind between stretches without any, from a seed."""

import itertools
from dataclasses import dataclass

import numpy as np

from fsw.drivers.wire import CanFrame
from tests.support.encoders import tpdo1, tpdo1_fd

MS = 1_000_000
PERIOD_NS = 2 * MS
T0 = 10**12
COUNTERS = 240
NODES = (0x11, 0x12, 0x13)
FD_NODE = 0x13
KINDS = (
    "lost", "doubled", "late", "overtaken", "torque", "jump", "stuck", "status", "no_torque",
    "length", "counter", "silent", "reset", "stranger", "sync_lost", "sync_doubled", "sync_invalid",
    "errors", "slow", "babble", "flags", "very_late", "sync_repeated",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Struck:
    """A fault of one node (or of the bus) in the SYNCs [start, stop)."""

    kind: str
    node: int
    start: int
    stop: int


def struck(rng: np.random.Generator, cycles: int, count: int) -> list[Struck]:
    """Return so many faults at random places, most of them short."""
    found = []
    for _ in range(count):
        start = int(rng.integers(5, cycles))
        length = int(rng.choice([1, 1, 2, 5, 20, 60]))
        kind, node = str(rng.choice(KINDS)), int(rng.choice(NODES))
        found.append(Struck(kind, node, start, start + length))
    return found


def traffic(rng: np.random.Generator, cycles: int, faults: list[Struck]) -> list[CanFrame]:
    """Return the frames of a bus in order of their stamps."""
    frames: list[CanFrame] = []
    offset = dict.fromkeys(NODES, 0.0)
    held: dict[int, float] = {}
    start = cycles // 2 * int(rng.integers(0, 2))  # until then the joints stand
    for k in range(cycles):
        now = [fault for fault in faults if fault.start <= k < fault.stop]
        kinds = {fault.kind for fault in now}
        at_ns = T0 + PERIOD_NS * k + int(rng.integers(0, 50_000))
        counter = k % COUNTERS + 1
        frames += syncs(at_ns, counter, kinds)
        frames += others(at_ns, now, rng)
        for place, node in enumerate(NODES):
            own = {fault.kind for fault in now if fault.node == node}
            q = 0.3 * float(np.sin(0.004 * max(0, k - start) * (place + 1)))
            if "jump" in own and k == min(f.start for f in now if f.kind == "jump"):
                offset[node] += (
                    float(rng.normal(0.0, 0.5)) if offset[node] == 0.0 else -offset[node]
                )
            q = held.setdefault(node, q) if "stuck" in own else q
            if "stuck" not in own:
                held.pop(node, None)
            frames += answers(at_ns, counter, node, q + offset[node], own, rng)
    order = sorted(range(len(frames)), key=lambda i: frames[i].t_ns)
    return [frames[i] for i in order]


def syncs(at_ns: int, counter: int, kinds: set[str]) -> list[CanFrame]:
    frame = CanFrame(at_ns, 0x080, bytes([counter]))
    found = [] if "sync_lost" in kinds else [frame]
    if "sync_doubled" in kinds:
        found.append(CanFrame(at_ns + 100_000, 0x080, frame.data))
    if "sync_repeated" in kinds:
        found.append(CanFrame(at_ns + 250 * MS + 20_000, 0x080, frame.data))
    if "sync_invalid" in kinds:
        found.append(CanFrame(at_ns + 120_000, 0x080, b"\xf9"))
    return found


def others(at_ns: int, now: list[Struck], rng: np.random.Generator) -> list[CanFrame]:
    """Return what is no sample of a configured node."""
    found = []
    for fault in now:
        t_ns = at_ns + int(rng.integers(100_000, 900_000))
        first = fault.node
        if fault.kind == "reset":
            found.append(CanFrame(t_ns, 0x700 + first, b"\x00"))
        elif fault.kind == "stranger":
            found.append(CanFrame(t_ns, 0x1AA, bytes(8)))
        elif fault.kind == "errors":
            classes = int(rng.choice([0x040, 0x100, 0x008]))
            found.append(CanFrame(t_ns, classes, bytes(8), is_error=True))
        elif fault.kind == "slow":
            found.append(CanFrame(t_ns, 0x280 + first, rng.bytes(8)))
            found.append(CanFrame(t_ns, 0x080 + first, rng.bytes(8)))
            found.append(CanFrame(t_ns, 0x700 + first, rng.bytes(1)))
        elif fault.kind == "babble":
            found += [CanFrame(t_ns + 50_000 * i, 0x7FF, bytes(8)) for i in range(8)]
        elif fault.kind == "flags":
            found.append(CanFrame(t_ns, 0x180 + first, bytes(8), is_extended=True))
            found.append(CanFrame(t_ns, 0x180 + first, b"", is_remote=True))
    return found


def answers(
    at_ns: int, counter: int, node: int, q: float, own: set[str], rng: np.random.Generator
) -> list[CanFrame]:
    """Return a node's frames for one SYNC."""
    if own & {"lost", "silent"} and ("silent" in own or rng.random() < 0.5):
        return []
    status = int(rng.choice([0x01, 0x49, 0x89, 0x19])) if "status" in own else 0x09
    status = int(rng.choice([0x08, 0x0B, 0x0D])) if "no_torque" in own else status
    torque = 150.0 if "torque" in own else float(rng.normal(0.0, 1.0))
    if "counter" in own:
        counter = int(rng.integers(0, 256))
    encode = tpdo1_fd if node == FD_NODE else tpdo1
    data = encode(q, torque, status, counter)
    if "length" in own:
        data = data[: int(rng.integers(0, len(data)))]
    delay_ns = 200_000 + 100_000 * (node - NODES[0])
    if "late" in own:
        delay_ns += int(rng.integers(1, 8)) * PERIOD_NS
    elif "very_late" in own:
        delay_ns += int(rng.integers(40, 80)) * PERIOD_NS
    elif "overtaken" in own and rng.random() < 0.5:
        delay_ns += PERIOD_NS
    frame = CanFrame(at_ns + delay_ns, 0x180 + node, data, is_fd=node == FD_NODE)
    if "doubled" in own:
        again = CanFrame(frame.t_ns + 30_000, frame.can_id, data, is_fd=frame.is_fd)
        return [frame, again]
    return [frame]


def cut(rng: np.random.Generator, count: int, mean: float) -> list[slice]:
    """Return slices that cut so many items into batches of random lengths."""
    bounds, at = [0], 0
    while at < count:
        at = min(count, at + 1 + int(rng.exponential(mean)))
        bounds.append(at)
    return [slice(a, b) for a, b in itertools.pairwise(bounds)]
