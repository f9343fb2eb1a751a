"""Faults of the machine: processors, memory, disk, processes, terminals, a slow client."""

import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

from evidence.fault_matrix.live_rows import Act, Hold, Lane
from evidence.fault_matrix.run import SCENARIO
from hil.run import live
from hil.run.live import LiveError, children, processes_of
from hil.run.processes import tied
from hil.world.scenario import at_rates, load

RATE_HZ, IMU_RATE_HZ = 100.0, 125  # low, because speed is not judged here
PATIENT = {"silent_periods": 500.0, "late_periods": 100, "jitter_s": 1.0, "tracker_late_s": 1.0}
HOG = """
import os, sys, time
os.sched_setaffinity(0, {int(sys.argv[1])})
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(60))
except PermissionError:
    pass
end = time.monotonic() + 0.7
while time.monotonic() < end:
    busy = time.monotonic() + 0.03
    while time.monotonic() < busy:
        pass
    time.sleep(0.005)
"""
DISK_BYTES = 64 << 20
BALLAST = "ballast"  # name of the file that fills the disk
LEAST_BYTES = 1 << 20  # less than any process already has, so every new mapping fails

LEAST_MAPPED = "MALLOC_MMAP_THRESHOLD_"  # glibc maps larger blocks separately, see mallopt(3)


def service_of(hold: Hold) -> int:
    """Return the process identifier of the daemon's service; LiveError if there is no service."""
    service = processes_of(hold.daemon).get("service")
    if service is None:
        raise LiveError("the daemon has no service process")
    return service


def _hog(hold: Hold) -> None:
    """Occupy the daemon's processor again and again, with a higher priority if the system allows.

    One long occupation would be one stall. The simulated devices are not part of the robot's
    computer. They get the other processors, if there are any.
    """
    taken, *others = sorted(os.sched_getaffinity(0))
    for process in (hold.daemon, *children(hold.daemon)):
        _pin(process, {taken})
    _pin(hold.plant, set(others) or {taken})
    hog = hold.stack.enter_context(subprocess.Popen(tied([sys.executable, "-c", HOG, str(taken)])))
    hold.stack.callback(hog.kill)


def _pin(process: int, cpus: set[int]) -> None:
    """Let all threads of a process run only on the processors `cpus`."""
    for thread in Path(f"/proc/{process}/task").iterdir():
        with suppress(ProcessLookupError):  # the thread has ended
            os.sched_setaffinity(int(thread.name), cpus)


def _small_disk(hold: Hold) -> None:
    """Mount a small separate disk for the recording, if this user may mount one."""
    folder = hold.folder / "recording"
    folder.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode == 0:
        hold.stack.callback(_keep_recording, folder)


def _keep_recording(folder: Path) -> None:
    kept = folder.with_suffix(".kept")
    shutil.copytree(folder, kept, ignore=shutil.ignore_patterns(BALLAST))
    subprocess.run(["umount", str(folder)], check=True)
    folder.rmdir()
    kept.rename(folder)


def _fill(hold: Hold) -> None:
    """Fill the small disk; without such a disk, limit the size of the service's files."""
    folder = hold.folder / "recording"
    if folder.is_mount():
        with (folder / BALLAST).open("wb", buffering=0) as file, suppress(OSError):  # no space left
            while file.write(bytes(1 << 20)):
                pass
        return
    size = max(path.stat().st_size for path in folder.glob("*.mcap"))
    hard = resource.prlimit(service_of(hold), resource.RLIMIT_FSIZE)[1]
    resource.prlimit(service_of(hold), resource.RLIMIT_FSIZE, (size, hard))


def _empty(hold: Hold) -> None:
    (hold.folder / "recording" / BALLAST).unlink(missing_ok=True)
    hard = resource.prlimit(service_of(hold), resource.RLIMIT_FSIZE)[1]
    resource.prlimit(service_of(hold), resource.RLIMIT_FSIZE, (hard, hard))


def _short_of_memory(hold: Hold) -> None:
    """Make every further allocation of memory fail in the service."""
    resource.prlimit(service_of(hold), resource.RLIMIT_AS, (LEAST_BYTES, LEAST_BYTES))


def _kill(hold: Hold) -> None:
    os.kill(service_of(hold), signal.SIGKILL)


def _hang_up(hold: Hold) -> None:
    os.kill(hold.plant, signal.SIGUSR1)


def _in_parts(hold: Hold) -> None:
    """Make the recorder begin a new file every 2 s."""
    hold.document["recorder"]["part_s"] = 2.0


def _without_reserve(hold: Hold) -> None:
    """Make the recorder end chunks as often as at full rates, and map new memory for each chunk.

    Otherwise the C library reuses memory that it has kept, and the limit acts at an unknown time.
    """
    hold.document["recorder"]["chunk_bytes"] = 1 << 15
    os.environ[LEAST_MAPPED] = "32768"
    hold.stack.callback(os.environ.pop, LEAST_MAPPED, None)


def _block_recorder(hold: Hold) -> None:
    """Move the recordings' directory away and put a file in its place."""
    folder = hold.folder / "recording"
    folder.rename(folder.with_suffix(".away"))
    folder.write_text("")


def _unblock_recorder(hold: Hold) -> None:
    folder = hold.folder / "recording"
    folder.unlink()
    folder.with_suffix(".away").rename(folder)


def _with_telemetry(hold: Hold) -> None:
    """Make the daemon send telemetry at its highest rates, with a small queue for every client."""
    hold.document["telemetry"] = {
        "port": live.free_tcp_port(),
        "queue_bytes": 1 << 16,
        "science_rate_hz": hold.document["scheduler"]["tick_rate_hz"],
        "science_interval_s": 1.0 / hold.document["scheduler"]["tick_rate_hz"],
        "housekeeping_interval_s": 0.01,
    }


class SlowClient:
    """A ground client that reads nothing until `read` is called, and then reads everything."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 15)
        self._socket.settimeout(0.5)
        self._socket.connect(("127.0.0.1", port))
        self._reads, self._ends = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="slow client")
        self._thread.start()

    def _run(self) -> None:
        while not self._ends.is_set():
            if self._reads.wait(0.05):
                try:
                    if not self._socket.recv(1 << 20):
                        return  # the daemon has ended
                except TimeoutError:
                    continue

    def read(self) -> None:
        """Begin to read."""
        self._reads.set()

    def close(self) -> None:
        """End the thread and close the connection."""
        self._ends.set()
        self._thread.join()
        self._socket.close()


def _slow_client() -> Act:
    clients: list[SlowClient] = []

    def connect(hold: Hold) -> None:
        client = SlowClient(int(hold.document["telemetry"]["port"]))
        hold.stack.callback(client.close)
        clients.append(client)

    def read(_hold: Hold) -> None:
        clients.pop().read()

    return Act(before=_with_telemetry, begin=connect, end=read)


def lane() -> Lane:
    """Return the lane of the faults of the machine."""
    return Lane(
        health=PATIENT,
        scenario=at_rates(load(SCENARIO), RATE_HZ, IMU_RATE_HZ),
        acts={
            "cpu_hog": Act(begin=_hog),
            "disk_full": Act(before=_small_disk, begin=_fill, end=_empty),
            "recorder_failure": Act(before=_in_parts, begin=_block_recorder, end=_unblock_recorder),
            "memory_limit": Act(before=_without_reserve, begin=_short_of_memory),
            "service_killed": Act(begin=_kill),
            "pty_hang_up": Act(begin=_hang_up),
            "slow_client": _slow_client(),
        },
    )
