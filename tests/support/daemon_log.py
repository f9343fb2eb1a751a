"""What the daemon of a run has written down itself, to compare its telemetry with.

Its recording (estimates, summaries, raw bytes), event log, kept tables and parameters.
"""

import json
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from fsw.config import load
from fsw.drivers.sources import ImuSource, JointBusSource, StarTrackerSource
from fsw.drivers.wire import ByteChunk, frame_array, unpack_frame
from fsw.exchange.recording import messages
from fsw.messages import Samples
from fsw.telemetry.state.command_log import COMMANDS_NAME
from fsw.telemetry.state.store import GenerationStore
from tests.support.live_run import LiveRun
from tests.support.samples import rows


class DaemonLog:
    """Everything of one run, read after its end."""

    def __init__(self, run: LiveRun) -> None:
        self.config = load(run.config_path)
        self.state, self.final, self.kept = run.state, run.status(), run.kept
        self.recordings = sorted((run.folder / "recording").glob("*.mcap"))
        self.estimates: dict[float, list[dict]] = defaultdict(list)
        self.summaries: list[dict] = []
        self.samples: dict[str, set[tuple[float, ...]]] = defaultdict(set)
        for path in self.recordings:
            self._read(path)
        self.by_ticks = {summary["ticks"]: summary for summary in self.summaries}
        lines = (self.state / "events.jsonl").read_text().splitlines()
        self.events = [json.loads(line) for line in lines]
        lines = (self.state / COMMANDS_NAME).read_text().splitlines()
        self.commands = [json.loads(line) for line in lines]
        tables = {"robot", "noise", "rates", "monitors"}
        self.tables = {n: GenerationStore(self.state / "tables" / n).read()[0] for n in tables}
        kept = GenerationStore(self.state / "parameters").read()[0]
        self.parameters = [json.loads(generation.content) for generation in kept]

    def _read(self, path: Path) -> None:
        for record in messages(path, ("/estimate", "/tm")):
            values = json.loads(record.data)
            if record.topic == "/tm":
                self.summaries.append(values)
            else:
                self.estimates[values["t_ns"] * 1e-9].append(values)
        self._decode(path)

    def _decode(self, path: Path) -> None:
        """Decode the recorded bytes once more: every sample with its time and values."""
        config, found = self.config, self.samples
        for bus in config.buses:
            joints = [(i, joint) for i, joint in enumerate(config.joints) if joint.bus == bus.name]
            source = JointBusSource(bus, joints, config.health)
            recorded = messages(path, (f"/can/{bus.name}",))
            frames = (unpack_frame(record.t_ns, record.data) for record in recorded)
            whole = frame_array(frame for frame in frames if frame is not None)
            for sample in rows(source.feed(whole)):
                values = (sample.position_rad, sample.torque_nm)
                found[f"joint_{sample.joint + 1}"].add(values)
                found["joint_time"].add((sample.t_ns * 1e-9,))
        imu = ImuSource(config.imu, None, config.health)
        for sample in fed(path, "/serial/imu", imu.feed):
            found["gyro"].add((sample.t_gyro_ns * 1e-9, *(sample.w_NS_S_rad_s or ())))
            found["acc"].add((sample.t_acc_ns * 1e-9, *(sample.f_NS_S_m_s2 or ())))
        if config.star_tracker is not None:
            tracker = StarTrackerSource(config.star_tracker, config.health)
            for sample in fed(path, "/serial/star_tracker", tracker.feed):
                found["attitude"].add((sample.t_ns * 1e-9, *sample.q_NB_xyzw))

    def file(self, name: str) -> Path:
        """The file a name of the ground stands for."""
        folder, _, rest = name.partition("/")
        root = self.state if folder == "files" else self.recordings[0].parents[1]
        return root / ("files" if folder == "files" else "recording") / rest


def fed(path: Path, topic: str, feed: Callable[[list[ByteChunk]], Samples]) -> Iterable[Any]:
    return rows(feed([ByteChunk(record.t_ns, record.data) for record in messages(path, (topic,))]))
