"""Propose which signals of a description the joints use: by names, by units, by what moves."""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fsw.checks.robot import MOST_EFFORT_NM
from fsw.drivers.codecs.canopen import COB_SYNC, NODE_MASK
from fsw.drivers.layout.files import read_messages
from fsw.drivers.layout.signals import Message, Signal, faults
from fsw.drivers.wire import NO_FRAMES, FrameArray
from fsw.errors import ConfigError, cut
from fsw.estimators.model.robot import RobotModel
from offline.can_logs.reading import read_can_log
from offline.checks.wiring import LEAST_FRAMES, frame_rate_hz, frames_of
from offline.init.columns import gaps, joint_groups
from offline.init.nodes import nodes_of
from offline.init.noise import Limits, rate_of, sizes_of
from offline.init.recording import RATE_HZ, Recorded, Wires, recorded
from offline.init.signals import Role, Use, chosen_use, unit_of

ARRIVAL = "timing: {by: arrival, sigma_s: 5.0e-5}  # CHECK how evenly the drive sends"
SYNCED = "timing: {by: last_sync}  # CHECK: of transmission type 1"
STATUS_WORD = "0x6041"  # of CiA 402
ENABLED = "mask: 0x000C, value: 0x0004}  # CHECK: enabled, no fault"
TPDOS = range(0x181, 0x580)  # identifiers of process data of nodes
FLOAT_NOISE_RAD = 1e-5  # a guess for a float, whose step is not known
ROUNDING = 0.3  # noise over step, rather more than that of rounding, 1 / root 12
RATED_NM = 1e3  # a guess for a joint whose <limit> is a placeholder
MOST_NOISE_RAD = 0.1  # more is a signal read in a wrong way
PORT = ("interface: socketcan  # CHECK any of python-can's", "channel: can0  # CHECK")
FEED = (
    "interface: samples",
    "channel: 127.0.0.1  # CHECK; without port: the path of a Unix socket",
    "port: 45454  # CHECK",
    "feed: {source: 1, clock: monotonic}  # CHECK docs/howto/feed.md",
)


def wired(arguments: argparse.Namespace, model: RobotModel) -> Recorded:
    """Return the proposal for a bus, nodes or a feed, with the rates and sizes of a log.

    Raises
    ------
    ConfigError when a file cannot be used, or no positions are found in it.
    """
    if arguments.feed:
        path = arguments.recording
        seen = Recorded(rate_hz=RATE_HZ) if path is None else recorded(path, model)
        wires = Wires(name="arm", bus=FEED, joints=[["driver: samples"]] * model.n)
        return replace(seen, wires=wires, mapping=[], nodes=())
    frames = NO_FRAMES if arguments.recording is None else read_can_log(arguments.recording).frames
    return (_of_bus if arguments.bus else _of_nodes)(arguments, model, frames)


def _of_bus(arguments: argparse.Namespace, model: RobotModel, frames: FrameArray) -> Recorded:
    name, is_pair, file = arguments.bus.partition("=")
    if not (is_pair and name and file):
        raise ConfigError(f"--bus: {arguments.bus!r} must be NAME=FILE")
    try:
        messages = read_messages(Path(file))
    except ConfigError as error:
        raise ConfigError(f"--bus: {error}") from error
    found = {
        f"{message.name}.{signal.name}": (message, signal)
        for message in messages.values()
        if _is_seen(message, frames) and not any(faults(message))
        for signal in message.signals
    }
    columns = [own.columns for own in joint_groups(list(found), model.joint_names, spare=True)]
    columns += [(column,) for column in found] if model.n == 1 else []
    uses = [Use([found[c][0] for c in own], [found[c][1] for c in own]) for own in columns]
    proposal = _Proposal.of(uses, model, frames, f"--bus: {file}", list(found))
    bus = [*PORT, "sync: none  # CHECK", "listen_only: true  # CHECK: another master runs the bus"]
    bus.append(f"description: {_place(Path(file), arguments)}")
    return proposal.recorded(name, bus, [[]] * model.n, ARRIVAL, proposal.rate_hz() or RATE_HZ)


def _of_nodes(arguments: argparse.Namespace, model: RobotModel, frames: FrameArray) -> Recorded:
    sending = {int(w) & NODE_MASK for w in np.unique(frames["word"]).tolist() if w in TPDOS}
    first = arguments.first_node
    ids = sorted(sending) if len(sending) >= model.n else range(first, first + model.n)
    try:
        nodes, rate_hz = nodes_of(arguments.eds, model.joint_names, ids)
    except ConfigError as error:
        raise ConfigError(f"--eds: {error}") from error
    uses = [
        Use([own.messages[name] for own in nodes], [signal] * model.n)
        for name, message in nodes[0].messages.items()
        for signal in message.signals
        if all(name in own.messages for own in nodes) and _is_seen(message, frames)
        if all(signal in own.messages[name].signals for own in nodes)
    ]
    proposal = _Proposal.of(uses, model, frames, f"--eds: {arguments.eds[0]}")
    bus, timing = ["sync: producer  # CHECK", "sync_counter_max: 0  # SYNC without data"], SYNCED
    sync_ns = frames["t_ns"][frames["word"] == COB_SYNC]
    if len(sync_ns) >= LEAST_FRAMES:
        bus = ["sync: consumer  # CHECK: as in the log", "listen_only: true  # CHECK"]
        rate_hz = rate_of(sync_ns * 1e-9)
    elif len(frames):
        bus, timing = ["sync: none  # CHECK: as in the log", "listen_only: true  # CHECK"], ARRIVAL
        rate_hz = proposal.rate_hz()
    own = [[f"node_id: 0x{node.node_id:02x}  # CHECK"] for node in nodes]
    if nodes[0].is_mapped:
        bus += ["messages:", *proposal.described()]
    else:
        for lines, node in zip(own, nodes, strict=True):
            lines.append(f"description: {_place(node.file, arguments)}")
    return proposal.recorded("arm", [*PORT, *bus], own, timing, rate_hz or RATE_HZ)


def _is_seen(message: Message, frames: FrameArray) -> bool:
    return not len(frames) or len(frames_of(message, frames)) >= LEAST_FRAMES


def _place(file: Path, arguments: argparse.Namespace) -> str:
    """Return the path of a file as the configuration names it."""
    own = file.absolute()
    return repr(own.name if own.parent == arguments.out.absolute().parent else str(own))


@dataclass(frozen=True, slots=True)
class _Proposal:
    """The signals of all joints."""

    position: Use
    torque: Use | None
    status: Use | None
    frames: FrameArray  # of a log; none: there is no log
    model: RobotModel

    @classmethod
    def of(
        cls,
        uses: Sequence[Use],
        model: RobotModel,
        frames: FrameArray,
        source: str,
        names: Sequence[str] = (),
    ) -> "_Proposal":
        """Choose the signals; raise ConfigError if none looks like the joints' positions.

        `names`: all signals, MESSAGE.SIGNAL; empty: each of `uses` stands for all.
        """
        position = chosen_use(uses, "position", frames)
        if position is None:
            held = ", ".join(dict.fromkeys(own.signals[0].name for own in uses))
            few = "".join(f"{words}; " for words in gaps(names, model.joint_names))
            raise ConfigError(
                f"{source}: no signals that look like the positions of "
                f"{cut(', '.join(model.joint_names))}{' in the log' * bool(len(frames))}; "
                + (f"one for each joint are: {cut(held)}; " * bool(held) + few)
                + f"it has: {cut(', '.join(names) or held or 'none')}"
            )
        torque = chosen_use(uses, "torque", frames) or chosen_use(uses, "current", frames)
        words = {own.messages[0].word for own in (position, torque) if own is not None}
        status = (
            own
            for own in uses
            if own.signals[0].name == STATUS_WORD and own.messages[0].word in words
        )
        return cls(position, torque, next(status, None), frames, model)

    def rate_hz(self) -> float:
        """Return the rate of the positions in the log; 0 without a log."""
        rates_hz = [
            frame_rate_hz(frames_of(message, self.frames)["t_ns"])
            for message in self.position.messages
        ]
        return float(f"{np.median(rates_hz):.6g}")

    def recorded(
        self,
        name: str,
        bus: Sequence[str],
        own: Sequence[Sequence[str]],
        timing: str,
        rate_hz: float,
    ) -> Recorded:
        """Return the lines; `own` are those of each joint that say where its node is."""
        torque, efforts = self.torque, self.model.model.effortLimit[6:].tolist()
        rated_nm = [own if 0.0 < own <= MOST_EFFORT_NM else RATED_NM for own in efforts]
        angles = [unit_of(*each, 0.0) for each in self._each(self.position, "position")]
        forces = [
            unit_of(*each, rated)
            for each, rated in zip(self._each(torque, "torque"), rated_nm, strict=False)
        ]
        joints = []
        for k, first in enumerate(own):
            lines = ["driver: described", *first, "signals:"]
            lines.append(f"  position: {self.position.text(k)}{angles[k].text}}}  # CHECK")
            if torque is not None:
                lines.append(f"  torque: {torque.text(k)}{forces[k].text}}}  # CHECK")
            if self.status is not None:
                lines.append(f"  status: {self.status.text(k)}, {ENABLED}")
            joints.append([*lines, timing])
        is_current = any(each.is_current for each in forces)
        return Recorded(
            rate_hz=rate_hz,
            has_torque=torque is not None,
            joints=self._sizes([e.factor for e in angles], [e.factor for e in forces]),
            wires=Wires(name=name, bus=bus, joints=joints),
            is_current=is_current,
        )

    def _each(self, use: Use | None, role: Role) -> list[tuple[Signal, Role, str]]:
        """Return signal, role and kind of each joint."""
        signals = [] if use is None else use.signals
        return [(own, role, kind) for own, kind in zip(signals, self.model.kinds(), strict=False)]

    def _sizes(self, angles: Sequence[float], forces: Sequence[float]) -> list[Limits]:
        """Return sizes and noise of the joints; without a log, the step of their positions.

        Parameters
        ----------
        angles, forces : SI value of a unit of each joint's position and torque
        """
        floors = [
            FLOAT_NOISE_RAD
            if own.number == "float"
            else min(ROUNDING * abs(own.scale * factor), MOST_NOISE_RAD)
            for own, factor in zip(self.position.signals, angles, strict=True)
        ]
        if not len(self.frames):
            return [Limits(position_noise_rad=floor) for floor in floors]
        floors = [floor * (floor != FLOAT_NOISE_RAD) for floor in floors]
        q = self.position.side_by_side(self.frames) * angles
        tau = None if self.torque is None else self.torque.side_by_side(self.frames) * forces
        count = len(q) if tau is None else min(len(q), len(tau))
        t_s = np.arange(count) / self.rate_hz()
        found = sizes_of(t_s, q[:count], None if tau is None else tau[:count], self.model.kinds())
        return [
            replace(own, position_noise_rad=min(max(own.position_noise_rad, floor), MOST_NOISE_RAD))
            for own, floor in zip(found, floors, strict=True)
        ]

    def described(self) -> Iterator[str]:
        """Yield the lines of the messages, for nodes whose mapping is in no file of their own."""
        uses = [own for own in (self.position, self.torque, self.status) if own is not None]
        for message in {own.word: own for use in uses for own in use.messages}.values():
            yield f"  - name: {message.name}"
            yield f"    id: 0x{message.identifier:x}"
            yield f"    length: {message.length}"
            yield "    signals:"
            for own in message.signals:
                scale = f", scale: {own.scale:.12g}" if own.scale != 1 else ""
                unit = f", unit: {own.unit}" if own.unit else ""
                yield (
                    f'      - {{name: "{own.name}", start: {own.start}, bits: {own.bits}, '
                    f"number: {own.number}{scale}{unit}}}"
                )
