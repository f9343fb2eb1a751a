"""Wiring: build the loop of a configuration on a given clock, given ports and a given sink.

`app.run_live` passes the clock and ports of the machine, the bench passes simulated ones.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from fsw.clock import Clock
from fsw.config import BusConfig, Config
from fsw.drivers.codecs import canopen
from fsw.drivers.codecs.entries import star_tracker_codec
from fsw.drivers.codecs.sdo import compared, written
from fsw.drivers.layout.files import read_mappings
from fsw.drivers.sources.bus_selection import BusSelector
from fsw.drivers.wire import FramePort
from fsw.exchange.sinks import IMU, STAR_TRACKER, Sink
from fsw.loop.bus_input import BusInput
from fsw.loop.inputs import Inputs
from fsw.loop.line_input import LineInput
from fsw.loop.link import Link
from fsw.loop.loop import Loop, nothing_due, nothing_more
from fsw.loop.node_setup import NodeSetup
from fsw.loop.ports import CAN, SECOND, Ports


def build(
    config: Config,
    clock: Clock,
    ports: Ports,
    sink: Sink,
    deadline_ns: Callable[[], int] = nothing_due,
    more: Callable[[], Mapping[str, Any]] = nothing_more,
) -> Loop:
    """Return the loop of a configuration; open no port and send nothing.

    `deadline_ns` returns the time at which the next window closes [ns]; 0 while it is unknown.
    `more` returns further values of each status.
    """
    buses = [bus_input(config, bus, clock, ports) for bus in config.buses if bus.feed is None]
    openers = ports.line_openers
    lines = [
        LineInput(bus.name, Link(bus.name, ports.feeds.get(bus.name), openers.get(bus.name)))
        for bus in config.buses
        if bus.feed is not None
    ]
    if config.imu.present and config.imu.bus is None:
        lines.append(LineInput(IMU, Link(IMU, ports.imu, openers.get(IMU))))
    if config.star_tracker is not None and config.star_tracker.bus is None:
        link = Link(STAR_TRACKER, ports.star_tracker, openers.get(STAR_TRACKER))
        subscribes = config.star_tracker.subscribe
        start = star_tracker_codec(config.star_tracker).start() if subscribes else b""
        lines.append(LineInput(STAR_TRACKER, link, start))
    return Loop(config, clock, sink, Inputs(buses, lines, clock, sink), deadline_ns, more)


def bus_input(config: Config, bus: BusConfig, clock: Clock, ports: Ports) -> BusInput:
    """Return the input of one bus; it has two links if the bus is a redundant pair."""
    names, selector = [bus.name], None
    if bus.redundant is not None:
        names.append(bus.name + SECOND)
        selector = BusSelector(bus.redundant)
    nodes = {
        node.node_id: canopen.encode_nmt(canopen.NmtCommand.START, node.node_id)
        for node in config.can_nodes
        if node.bus == bus.name and node.node_id is not None
    }
    links: list[Link[FramePort]] = [
        Link(CAN + name, ports.can.get(name), ports.can_openers.get(name)) for name in names
    ]
    beat = canopen.encode_heartbeat(canopen.NmtState.OPERATIONAL, canopen.MASTER_NODE)
    return BusInput(
        bus.name,
        nodes,
        links,
        bus.sync_counter_max,
        clock,
        beat,
        selector,
        listen_only=bus.listen_only,
        setups=_setups(config, bus),
    )


def _setups(config: Config, bus: BusConfig) -> dict[int, NodeSetup]:
    """Return the setups of nodes whose PDOs are checked or written, by node number."""
    found = {}
    for joint in config.joints:
        node, path = joint.node_id, joint.description
        if joint.bus != bus.name or joint.pdo == "trusted" or node is None or path is None:
            continue
        names = {own.message for own in (joint.signals or {}).values()}
        pdos = read_mappings(config.resolve(path), node, names)
        dialogue = written if joint.pdo == "written" else compared
        found[node] = NodeSetup(node, joint.name, partial(dialogue, pdos))
    return found
