"""Wiring: a daemon from its configuration, on whatever clock, ports and sink it is given.

`app.run_live` gives it the machine's, the HIL simulated ones, a replay a recording's. There is no
second daemon.
"""

from __future__ import annotations

from fsw.clock import Clock
from fsw.config import BusConfig, Config
from fsw.drivers.wire import BytePort, FramePort
from fsw.estimators.pipeline import Pipeline, default_pipeline
from fsw.exchange.sinks import Sink
from fsw.loop.bus_input import BusInput, OtherFrames
from fsw.loop.daemon import Daemon
from fsw.loop.line_input import ChunkSource, LineInput
from fsw.loop.link import Link
from fsw.loop.ports import CAN, IMU, JOINTS, SECOND, STAR_TRACKER, Ports


def build(
    config: Config,
    clock: Clock,
    ports: Ports,
    sink: Sink,
    *,
    pipeline: Pipeline | None = None,
) -> Daemon:
    """Wire one daemon; opens and sends nothing.

    Parameters
    ----------
    pipeline : conditioning and estimation; None: as the configuration says
    """
    from fsw.drivers.sources import ImuSource, StarTrackerSource

    sampled = ports.samples
    buses = [_bus_input(config, bus, clock, ports) for bus in config.buses if JOINTS not in sampled]

    def line(name: str, port: BytePort | None, source: ChunkSource, start: bytes) -> LineInput:
        return LineInput(name, Link(name, port, ports.line_openers.get(name)), source, start)

    lines = [
        LineInput(name, Link(name, port, None), _sample_source(name, config), b"", is_sampled=True)
        for name, port in sampled.items()
    ]
    if config.imu.present and IMU not in sampled:
        lines.append(line(IMU, ports.imu, ImuSource(config.imu, None, config.health), b""))
    if config.star_tracker is not None and STAR_TRACKER not in sampled:
        tracker = StarTrackerSource(config.star_tracker, config.health)
        lines.append(line(STAR_TRACKER, ports.star_tracker, tracker, tracker.start_bytes()))
    return Daemon(
        config,
        clock,
        sink,
        buses=buses,
        lines=lines,
        pipeline=pipeline or default_pipeline(config),
        passive=ports.passive,
    )


def _sample_source(name: str, config: Config) -> ChunkSource:
    """Return the source of decoded samples of the joints, the inertial unit or the star tracker."""
    from fsw.drivers.sources import samples

    if name == JOINTS:
        return samples.joint_samples(config)
    if name == STAR_TRACKER and config.star_tracker is not None:
        return samples.attitude_samples(config.star_tracker)
    return samples.imu_samples(config.imu)


def _bus_input(config: Config, bus: BusConfig, clock: Clock, ports: Ports) -> BusInput:
    """Return the input of one bus; with its redundant one, where nodes may be commanded."""
    from fsw.drivers.codecs import canopen
    from fsw.drivers.sources import BusSelector, JointBusSource, ThrusterBusSource, WheelBusSource

    joints = [(i, joint) for i, joint in enumerate(config.joints) if joint.bus == bus.name]
    wheels = [(i, wheel) for i, wheel in enumerate(config.wheels) if wheel.bus == bus.name]
    thrusters = [(i, own) for i, own in enumerate(config.thrusters) if own.bus == bus.name]
    names = [bus.name]
    nodes: dict[int, tuple[int, bytes]] = {}
    selector = None
    if not ports.passive:
        start = canopen.NmtCommand.START
        own = [node.node_id for node in config.can_nodes if node.bus == bus.name]
        nodes = {node: canopen.encode_nmt(start, node) for node in own}
        if bus.redundant is not None:
            names.append(bus.name + SECOND)
            selector = BusSelector(bus.redundant)
    links: list[Link[FramePort]] = [
        Link(CAN + name, ports.can.get(name), ports.can_openers.get(name)) for name in names
    ]
    beat = canopen.encode_heartbeat(canopen.NmtState.OPERATIONAL, canopen.MASTER_NODE)
    source = JointBusSource(bus, joints, config.health)
    others: list[OtherFrames] = [WheelBusSource(bus, wheels)] if wheels else []
    others += [ThrusterBusSource(bus, thrusters)] if thrusters else []
    return BusInput(bus.name, nodes, links, source, clock, beat, selector, others)
