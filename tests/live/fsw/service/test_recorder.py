import subprocess
import sys
from pathlib import Path

import pytest

from fsw.exchange.recording import contents
from fsw.exchange.recording_writer import RecordingWriter
from fsw.messages import Event
from fsw.service.recorder import RecorderSink, open_recording, recorded_config
from tests.conftest import ArmProject
from tests.support.loop_cases import arm_config, make_estimate


def test_a_recording_carries_a_configuration_that_reads_back(arm: ArmProject, tmp_path: Path):
    config = arm_config(arm)
    open_recording(config, tmp_path / "rec" / "a.mcap").close()
    folder = tmp_path / "unpacked"
    folder.mkdir()
    again = recorded_config(tmp_path / "rec" / "a.mcap", folder)
    assert again.joints == config.joints
    assert again.bodies == config.bodies
    urdf = again.resolve(again.robot.urdf)
    assert urdf.read_bytes() == config.resolve(config.robot.urdf).read_bytes()


def test_a_full_disk_is_told_once_counted_and_never_raised(tmp_path: Path):
    if not Path("/dev/full").exists():
        pytest.skip("needs /dev/full")
    told: list[tuple[str, str, str]] = []
    writer = RecordingWriter(tmp_path / "a.mcap", chunk_bytes=4096)
    sink = RecorderSink(writer, lambda *text: told.append(text))
    writer._file.close()
    writer._file = writer._writer._Writer__stream = Path("/dev/full").open("wb")  # noqa: SIM115
    for k in range(2000):
        sink.put(make_estimate(k))
    sink.put(Event(1, "info", "X", "y"))
    sink.close()
    assert [code for _, code, _ in told] == ["DISK_FULL"]
    assert sink.lost > 1000


STARVED = """
import resource, sys
from pathlib import Path
from fsw.drivers.wire import ByteChunk
from fsw.exchange.sinks import SerialTraffic, StatusReport
from fsw.service.recorder import RecorderSink
from fsw.exchange.recording_writer import RecordingWriter
sink = RecorderSink(RecordingWriter(Path(sys.argv[1]), chunk_bytes=1 << 30), print)
sink.put(SerialTraffic("imu", [ByteChunk(0, bytes(1 << 16))]))
resource.setrlimit(resource.RLIMIT_AS, (1 << 20, 1 << 20))
try:
    sink.put(StatusReport(0, {}))
except MemoryError:
    print("no memory")
"""


def test_compression_without_memory_is_that_and_no_fault_of_the_file(tmp_path: Path):
    command = [sys.executable, "-c", STARVED, str(tmp_path / "a.mcap")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout == "no memory\n", done.stderr


def test_the_drop_count_is_written(tmp_path: Path):
    sink = RecorderSink(RecordingWriter(tmp_path / "a.mcap"), lambda *_: None)
    sink.dropped = 7
    sink.close()
    assert contents(tmp_path / "a.mcap").metadata == {"recorder": {"dropped": "7"}}
