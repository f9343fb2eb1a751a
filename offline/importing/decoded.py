"""What a description reads in the frames of a log: signals, samples, and what is left out."""

import numpy as np

from fsw.config import BusConfig, Config
from fsw.drivers.codecs.canopen import COB_SYNC
from fsw.drivers.layout.joints import all_layouts, in_words, layouts_of
from fsw.drivers.sources.described import DescribedBusSource
from fsw.drivers.sources.device_reports import SERVICES
from fsw.drivers.wire import EFF_MASK, FrameArray

LISTED = 8  # identifiers in one line


def decoded_lines(config: Config, bus: BusConfig, frames: FrameArray) -> list[str]:
    """Return a line for each described device, and one for the frames that none names."""
    every, layouts = all_layouts(config, bus), layouts_of(config, bus)
    others = [(at, own) for at, own in every.items() if not at.startswith("joints.")]
    read = [f"  {in_words(config.bus_devices[at], own)}" for at, own in others]
    words = [own.word for layout in every.values() for own in layout.messages]
    tailored = [own for own in config.can_nodes if own.bus == bus.name and own.driver == "canopen"]
    words += [service | (own.node_id or 0) for own in tailored for service in SERVICES]
    if not layouts:
        return [*read, *_others(words, frames)] if read else []
    source = DescribedBusSource(bus, [(i, config.joints[i]) for i in layouts], layouts)
    source.feed(frames)
    counts = source.joint_counters
    lines = [
        f"  {in_words(config.joints[i], layout)}: {_samples(counts[i])}"
        for i, layout in layouts.items()
    ]
    together = source.counters
    lines += [
        f"  {together[key]} samples {words}"
        for key, words in (
            ("torque_unusable", "without their torque"),
            ("incomplete", "left out: their position did not come in time"),
        )
        if together[key]
    ]
    return [*lines, *read, *_others(words, frames)]


def _samples(counts: dict[str, int]) -> str:
    """Return the number of samples, and why others are left out."""
    out = [
        f"{value} {key.removeprefix('reject_')}"
        for key, value in counts.items()
        if value and (key == "lost" or key.startswith("reject_"))
    ]
    return f"{counts['accepted']} samples{'; left out: ' * bool(out)}{', '.join(out)}"


def _others(words: list[int], frames: FrameArray) -> list[str]:
    """Return a line on the frames that are not described, the most frequent first."""
    rest = frames["word"][~np.isin(frames["word"], [*words, COB_SYNC])]
    if not rest.size:
        return []
    found, counts = np.unique(rest, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    listed = ", ".join(f"0x{found[k] & EFF_MASK:x} ({counts[k]})" for k in order[:LISTED])
    more = f" and {len(found) - LISTED} more" if len(found) > LISTED else ""
    return [f"  not described: {len(rest)} frames of {listed}{more}"]
