"""Fakes of clock, ports, sink and estimation for the tests of the loop."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from fsw.config import Config, load
from fsw.drivers.wire import ByteChunk, CanFrame, FrameArray, frame_array, frame_list
from fsw.errors import PortError
from fsw.exchange.sinks import (
    AppliedCommand,
    CanTraffic,
    ScienceRecord,
    SerialTraffic,
    StatusReport,
)
from fsw.messages import Block, BodyEstimate, Estimate, Window
from fsw.messages.commands import Reply
from hil.run.collector import Collector
from tests.conftest import ArmProject

MS = 1_000_000


class FakeClock:
    """Time passes in sleeps, and by `cost_ns` at every look when the test says so."""

    def __init__(self, now_ns: int = 0) -> None:
        self.now = now_ns
        self.cpu = 0
        self.wakes: list[int] = []  # instants at which a descriptor becomes readable

    def now_ns(self) -> int:
        return self.now

    def cpu_time_ns(self) -> int:
        return self.cpu

    def sleep_until_ns(self, deadline_ns: int, wake_fds: Sequence[int] = ()) -> bool:
        if wake_fds and self.wakes and self.wakes[0] < deadline_ns:
            self.now = max(self.now, self.wakes.pop(0))
            return False
        self.now = max(self.now, deadline_ns)
        return True


class FakePort:
    """What the test queues; fails while `broken`."""

    def __init__(self, clock: FakeClock, fds: tuple[int, ...] = ()) -> None:
        self.clock = clock
        self.fds = fds
        self.queue: list = []
        self.drained: list = []
        self.written: list[tuple[int, int, bytes]] = []
        self.broken = False
        self.closed = False

    def _check(self) -> None:
        if self.broken:
            raise PortError("unplugged")

    def _taken(self) -> list:
        self._check()
        taken, self.queue = self.queue, []
        return taken

    def wake_fds(self) -> tuple[int, ...]:
        return self.fds

    def close(self) -> None:
        self.closed = True


class FakeCan(FakePort):
    hands_back = False
    dropped = 0
    full = False

    def drain(self) -> None:
        self.drained += self._taken()

    def take(self) -> Callable[[], FrameArray]:
        drained, self.drained = self.drained, []
        return lambda: frame_array(drained).copy()  # the reader may write into it

    def take_dropped(self) -> int:
        dropped, self.dropped = self.dropped, 0
        return dropped

    def write(self, can_id: int, data: bytes) -> CanFrame | None:
        self._check()
        if self.full:
            return None
        self.written.append((self.clock.now, can_id, data))
        return CanFrame(self.clock.now, can_id, data)


class FakeSerial(FakePort):
    def read(self) -> list[ByteChunk]:
        return self._taken()

    def write(self, data: bytes) -> None:
        self._check()
        self.written.append((self.clock.now, 0, data))

    def put(self, data: bytes) -> None:
        self.queue.append(ByteChunk(self.clock.now, data))


class KeepSink(Collector):
    """Keeps everything in lists."""

    def __init__(self) -> None:
        super().__init__()
        self.frames: list[CanFrame] = []
        self.chunks: list[ByteChunk] = []
        self.statuses: list[dict] = []
        self.commands: list[dict] = []
        self.replies: list = []
        self.records: list[tuple[int, bytes]] = []
        self.closed = False

    def put(self, message):
        super().put(message)
        match message:
            case CanTraffic():
                self.frames += frame_list(message.frames)
            case SerialTraffic():
                self.chunks += message.chunks
            case StatusReport():
                self.statuses.append(dict(message.values))
            case AppliedCommand():
                self.commands.append(dict(message.record))
            case ScienceRecord():
                self.records.append((message.t_ns, message.data))
            case Reply():
                self.replies.append(message)

    def close(self):
        self.closed = True


def make_block(index: int, joints: int = 3, nodes: int = 4) -> Block:
    """A block whose every number tells its index."""
    per_joint = np.full((nodes, joints), float(index))
    per_axis = np.full((nodes, 3), index + 0.5)
    return Block(
        index=index,
        t_ns=np.arange(nodes, dtype=np.int64) * 100 * MS + index * 400 * MS,
        q_rad=per_joint,
        qd_rad_s=per_joint,
        qdd_rad_s2=per_joint,
        tau_nm=per_joint,
        w_NB_B_rad_s=per_axis,
        wd_NB_B_rad_s2=per_axis,
        f_NS_B_m_s2=per_axis,
        R_NB=np.broadcast_to(np.eye(3), (nodes, 3, 3)).copy(),
        cov_joint=np.full((joints, 2 * nodes, 2 * nodes), float(index)),
        cov_tau=np.full((joints, nodes, nodes), float(index)),
        cov_gyro=np.eye(2 * nodes),
        cov_acc=np.eye(nodes),
        has_joint=np.ones(joints, dtype=bool),
        has_gyro=True,
        has_accelerometer=index % 2 == 0,
        has_attitude=False,
    )


def make_estimate(t_ns: int, blocks: int = 1, mass_kg: float = 80.0) -> Estimate:
    return Estimate(
        t_ns=t_ns,
        reasons=(),
        method="fake",
        names=("m",),
        mean=np.array([mass_kg]),
        covariance=np.eye(1),
        bodies={
            "target": BodyEstimate(
                mass_kg=mass_kg,
                com_m=np.zeros(3),
                inertia_kg_m2=np.ones(6),
                mass_sigma_kg=1.0,
                com_sigma_m=np.ones(3),
                inertia_sigma_kg_m2=np.ones(6),
                physically_consistent=True,
            )
        },
        blocks=blocks,
        gated=0,
        nis=1.0,
        nis_dof=1,
        condition_number=1.0,
        information_gained_nats=0.0,
    )


class FakeConditioner:
    """Hands every window on as a block; keeps the windows."""

    def __init__(self) -> None:
        self.windows: list[Window] = []

    def blocks(self, windows: Sequence[Window]) -> list[Block | None]:
        self.windows += windows
        return [make_block(window.index) for window in windows]


class FakeEstimator:
    """Counts what it is asked."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.pushed: list[int] = []
        self.adopted: list = []

    def push(self, block: Block) -> Estimate:
        self.pushed.append(block.index)
        self.calls.append("push")
        return make_estimate(int(block.t_ns[0]), len(self.pushed))

    def work(self) -> None:
        self.calls.append("work")

    def finish(self) -> Estimate:
        self.calls.append("finish")
        return make_estimate(0, len(self.pushed))

    def reset(self) -> None:
        self.calls.append("reset")

    def adopt(self, result) -> None:
        self.adopted.append(result)


def arm_config(arm: ArmProject, **changes: dict) -> Config:
    """The arm's configuration with some sections changed."""
    for section, values in changes.items():
        arm.data[section] = {**arm.data.get(section, {}), **values}
    path: Path = arm.write()
    return load(path)
