"""Channels: decode the batches of frames and chunks of each bus and line into samples."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from fsw.config import BusConfig, Config
from fsw.drivers.codecs.canopen import COB_SYNC
from fsw.drivers.layout.joints import layouts_of
from fsw.drivers.sources import (
    DescribedBusSource,
    FeedSource,
    ImuSource,
    JointBusSource,
    StarTrackerSource,
)
from fsw.drivers.sources.described_sensors import SensorBusSource
from fsw.drivers.sources.devices import DEVICE_SAMPLES, other_sources
from fsw.drivers.sources.samples import (
    attitude_samples,
    imu_samples,
    joint_samples,
)
from fsw.drivers.wire import ByteChunk, FrameArray, joined, picked
from fsw.exchange.sinks import (
    IMU,
    JOINTS,
    STAR_TRACKER,
    CanTraffic,
    SerialTraffic,
)
from fsw.exchange.status import source_samples
from fsw.messages import Samples
from fsw.messages.findings import Finding
from fsw.scheduler.align import Aligner


class BusChannel:
    """Decodes the frames of all devices of one bus."""

    def __init__(self, config: Config, bus: BusConfig) -> None:
        joints = [
            (i, joint)
            for i, joint in enumerate(config.joints)
            if joint.bus == bus.name and joint.driver != "samples"
        ]
        self.name = bus.name
        layouts = layouts_of(config, bus)
        self.source: JointBusSource | DescribedBusSource
        if layouts:
            self.source = DescribedBusSource(bus, joints, layouts, config.health)
        else:
            self.source = JointBusSource(bus, joints, config.health)
        self.others, self._has_joints = other_sources(config, bus), bool(joints)
        words = [word for part in (self.source, *self.others) for word in part.words]
        self._starts = words if bus.sync == "none" else [COB_SYNC]  # begin the grid of windows
        self._waiting: list[FrameArray] = []

    @property
    def waiting(self) -> int:
        """Number of frames not decoded yet."""
        return sum(map(len, self._waiting))

    @property
    def counters(self) -> dict[str, dict[str, int]]:
        """Counters of the bus, which are those of its joints if it has some, and of sensors."""
        bus = self.source.counters
        for own in () if self._has_joints else self.others:
            bus |= {key: bus.get(key, 0) + count for key, count in own.counters.items()}
        sensors = [own for own in self.others if isinstance(own, SensorBusSource)]
        return {self.name: bus} | {own.kind: own.counters for own in sensors}

    def put(self, traffic: CanTraffic | SerialTraffic) -> None:
        """Keep frames until the end of the batch."""
        if isinstance(traffic, CanTraffic) and len(traffic.frames):
            self._waiting.append(traffic.frames)

    def first_ns(self) -> int | None:
        """Return the stamp of the first waiting frame that begins the grid [ns]; None: none does.

        It is a SYNC; on a bus without SYNC, a frame of a device.
        """
        first = [part["t_ns"][np.isin(part["word"], self._starts)] for part in self._waiting]
        return next((int(t_ns[0]) for t_ns in first if t_ns.size), None)

    def decoded(self) -> Iterator[tuple[Samples, bool]]:
        """Decode the waiting items; yield samples and whether to check them for stuck values."""
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return
        frames = joined(waiting)
        is_of_others = np.zeros(len(frames), np.bool_)
        for other in self.others:  # which may share a message, among them and with the joints
            yield other.feed(frames), isinstance(other, SensorBusSource) and other.is_screened
            is_of_others |= other.owns(frames)
        if is_of_others.any():
            is_of_others &= ~np.isin(frames["word"], list(self.source.words))
            frames = picked(frames, ~is_of_others)
        yield self.source.feed(frames), True

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Find out which devices are silent; `up`: whether the bus has its port."""
        for part in (self.source, *self.others):
            part.watch(now_ns, up=up)

    def findings(self) -> list[Finding]:
        """Return the faults found since the last call."""
        return [found for part in (self.source, *self.others) for found in part.findings()]

    def events(self) -> Sequence[tuple[str, str, str]]:
        """Return the events since the last call: severity, code, text."""
        return self.source.events()


class ChunkSource(Protocol):
    """The codec of one serial device, with counters."""

    @property
    def counters(self) -> dict[str, int]:
        """Counters by name."""
        ...

    def lacks(self) -> str:
        """Return in words which data the device has never sent; empty: none is missing."""
        ...

    def feed(self, chunks: Sequence[ByteChunk]) -> Samples:
        """Decode chunks in order."""
        ...

    def findings(self) -> Sequence[Finding]:
        """Return the faults found since the last call."""
        ...

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Check whether the device has become silent; `up`: whether its port is open."""
        ...


class LineChannel:
    """Decodes one serial device, or accepts samples decoded by another program (`is_sampled`).

    `starts`: the grid of windows begins at the first sample of this channel.
    """

    def __init__(
        self, name: str, source: ChunkSource, *, is_sampled: bool, starts: bool = False
    ) -> None:
        self.name, self.source = name, source
        self._is_sampled, self._starts = is_sampled, starts
        self._waiting: list[ByteChunk] = []

    @property
    def waiting(self) -> int:
        """Number of chunks not decoded yet."""
        return len(self._waiting)

    @property
    def counters(self) -> dict[str, dict[str, int]]:
        """Counters of the device, by its name."""
        return {self.name: self.source.counters}

    def put(self, traffic: CanTraffic | SerialTraffic) -> None:
        """Keep chunks until the end of the batch."""
        if isinstance(traffic, SerialTraffic):
            self._waiting += traffic.chunks

    def first_ns(self) -> int | None:
        """Return the stamp of the first waiting chunk [ns]; None: none waits, or not `starts`."""
        return self._waiting[0].t_ns if self._waiting and self._starts else None

    def decoded(self) -> Iterator[tuple[Samples, bool]]:
        """Decode the waiting items; yield samples and whether to check them for stuck values."""
        waiting, self._waiting = self._waiting, []
        if waiting:
            yield self.source.feed(waiting), not self._is_sampled

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Find out whether the device is silent; `up`: whether it has its port."""
        self.source.watch(now_ns, up=up)

    def findings(self) -> Sequence[Finding]:
        """Return the faults found since the last call."""
        return self.source.findings()

    def events(self) -> Sequence[tuple[str, str, str]]:
        """Return no events: a serial device raises none here."""
        return ()


class FeedChannel:
    """Decodes the datagrams of one feed, of up to three devices."""

    def __init__(self, config: Config, bus: BusConfig) -> None:
        self.name = bus.name
        self.source = FeedSource(config, bus)
        self._waiting: list[ByteChunk] = []

    @property
    def waiting(self) -> int:
        """Number of datagrams not decoded yet."""
        return len(self._waiting)

    @property
    def counters(self) -> dict[str, dict[str, int]]:
        """Counters by name of the feed or device."""
        return self.source.counters

    def put(self, traffic: CanTraffic | SerialTraffic) -> None:
        """Keep datagrams until the end of the batch."""
        if isinstance(traffic, SerialTraffic):
            self._waiting += traffic.chunks

    def first_ns(self) -> int | None:
        """Return the stamp of the first waiting datagram [ns]; None: none waits."""
        return self._waiting[0].t_ns if self._waiting else None

    def decoded(self) -> Iterator[tuple[Samples, bool]]:
        """Decode the waiting datagrams; the steps of the sender's values are not known."""
        waiting, self._waiting = self._waiting, []
        for samples in self.source.feed(waiting):
            yield samples, False

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Find out whether the sender is silent; `up`: whether the feed is open."""
        self.source.watch(now_ns, up=up)

    def findings(self) -> Sequence[Finding]:
        """Return the faults found since the last call."""
        return self.source.findings()

    def events(self) -> Sequence[tuple[str, str, str]]:
        """Return no events: a feed raises none here."""
        return ()


Channel = BusChannel | LineChannel | FeedChannel


def channels_of(config: Config, sampled: Collection[str]) -> dict[str, Channel]:
    """Return the channels of a configuration by name, in the order in which they are decoded.

    `sampled`: names of the sensors whose samples another program has decoded.
    """
    found: list[Channel] = []
    if JOINTS in sampled:
        found.append(LineChannel(JOINTS, joint_samples(config), is_sampled=True, starts=True))
    else:
        found += [
            BusChannel(config, bus) if bus.feed is None else FeedChannel(config, bus)
            for bus in config.buses
        ]
    for name, source_of in DEVICE_SAMPLES.items():
        if name in sampled:
            found.append(LineChannel(name, source_of(getattr(config, name)), is_sampled=True))
    imu, tracker, health = config.imu, config.star_tracker, config.health
    if IMU in sampled:
        starts = not config.joints
        found.append(LineChannel(IMU, imu_samples(imu), is_sampled=True, starts=starts))
    elif imu.present and imu.bus is None:
        found.append(LineChannel(IMU, ImuSource(imu, None, health), is_sampled=False))
    is_sampled = STAR_TRACKER in sampled
    if tracker is not None and (is_sampled or tracker.bus is None):
        source = attitude_samples(tracker) if is_sampled else StarTrackerSource(tracker, health)
        found.append(LineChannel(STAR_TRACKER, source, is_sampled=is_sampled))
    return {channel.name: channel for channel in found}


def sample_status(
    config: Config, align: Aligner, channels: Mapping[str, Channel]
) -> dict[str, Any]:
    """Return the counters and slow values of the sources as plain values."""
    buses = [channel for channel in channels.values() if isinstance(channel, BusChannel)]
    late = align.counters().late
    for bus in config.buses:
        late[bus.name] = sum(late[joint.name] for joint in config.joints if joint.bus == bus.name)
    late[JOINTS] = sum(late[joint.name] for joint in config.joints)
    found: dict[str, Any] = {
        "samples": {
            name: source_samples(counters, late[name])
            for channel in channels.values()
            for name, counters in channel.counters.items()
        },
        "lacks": {
            name: words
            for name, channel in channels.items()
            if isinstance(channel, LineChannel) and (words := channel.source.lacks())
        },
        "joints": {name: slow for b in buses for name, slow in b.source.motor_side().items()},
        "late_joints": {joint.name: late[joint.name] for joint in config.joints},
    }
    for other in (own for bus in buses for own in bus.others):
        if isinstance(other, SensorBusSource):
            continue
        found.setdefault(other.kind, {}).update(other.status())
    return found
