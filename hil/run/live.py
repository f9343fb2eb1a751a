"""A run in real time: this module starts and watches the processes of plant and daemon."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fsw.config.telemetry import TelemetryConfig
from fsw.errors import ConfigError
from fsw.exchange.recording import RecordedMessage, messages
from fsw.messages import Event
from hil.run.processes import tied
from hil.run.progress import Meter

START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 60.0
POLL_S = 0.1
STALE_NS = 1_500_000_000  # age of a status from which on it does not describe the run
_CLAIMS: list[socket.socket] = []  # sockets that claim UDP ports
PROCESS = re.compile(r"fsw\.(?:loop\.)?(\w+)\.process")  # module of a process of the daemon


class LiveError(RuntimeError):
    """A process of the run did not start, died, or left no recording."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Results of a run in real time: recordings and last messages of the daemon, plant's times."""

    recordings: tuple[Path, ...]  # the files of this run, oldest first
    final: Mapping[str, Any]  # the last /estimate message
    status: Mapping[str, Any]  # the last /tm message
    plant: Mapping[str, Any]  # the plant's closing line: origin_ns, imu, stalls_ns
    exit_code: int
    wall_s: float


def free_udp_ports(count: int) -> list[int]:
    """Return different unused UDP ports; no other bench gets them until this process ends.

    A multicast bus opens its port much later; without a claim two benches could share it.
    """
    with ExitStack() as probes:
        ports: list[int] = []
        while len(ports) < count:
            probe = probes.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            probe.bind(("127.0.0.1", 0))
            port = int(probe.getsockname()[1])
            if _claimed(port):
                ports.append(port)
    return ports


def _claimed(port: int) -> bool:
    """Claim a port for the life of this process; return False if another bench has it."""
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0hil-udp-port-{port}")
    except OSError:  # claimed by another bench
        claim.close()
        return False
    _CLAIMS.append(claim)
    return True


def free_tcp_port() -> int:
    """Return a TCP port on which no process listens now."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def require_free(host: str, port: int) -> None:
    """Raise LiveError if the daemon's link for the ground cannot listen on a TCP port."""
    try:
        socket.create_server((host, port), family=_family(host)).close()
    except OSError as error:
        words = os.strerror(error.errno) if error.errno else str(error)
        raise LiveError(f"telemetry.port {port} on {host}: {words}; choose another") from error


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def require_multicast(bus: Mapping[str, Any]) -> None:
    """Raise LiveError with the remedy if a bus over IPv4 multicast has no route here."""
    group = str(bus.get("channel"))
    if bus.get("interface") not in ("udp_multicast", "udp_frames") or ":" in group:
        return
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            member = socket.inet_aton(group) + socket.inet_aton("0.0.0.0")
            probe.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            probe.connect((group, 9))
    except OSError as error:
        raise LiveError(
            f"no CAN over UDP multicast {group} here: {error.strerror or error}; where no route is:"
            " `ip link set lo up multicast on && ip route add 239.0.0.0/8 dev lo`;"
            " --fast needs none"
        ) from error


Disturb = Callable[[float, int, int], None]  # seconds done, process ids of plant and daemon


def children(pid: int) -> list[int]:
    """Return the ids of the processes that a process has started; none if it has ended."""
    try:
        text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    except (FileNotFoundError, ProcessLookupError):  # the process has ended
        return []
    return [int(word) for word in text.split()]


def processes_of(daemon: int) -> dict[str, int]:
    """Return the process ids of a daemon's children by name: `service`, `estimation`."""
    found: dict[str, int] = {}
    for pid in children(daemon):
        with suppress(FileNotFoundError, ProcessLookupError):
            words = Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8").split("\0")
            found |= {named[1]: pid for word in words if (named := PROCESS.fullmatch(word))}
    return found


def nothing(_done_s: float, _plant: int, _daemon: int) -> None:
    """Do not disturb the run."""


class Announcement:
    """Prints once that the daemon's link is open; commands sent earlier are refused.

    Raises LiveError if the link could not be opened.
    """

    def __init__(self, folder: Path, link: TelemetryConfig) -> None:
        require_free(link.host, link.port)
        self._state = folder / "state" / "status.json"
        self._is_said = False

    def __call__(self, _done_s: float, _plant: int, _daemon: int) -> None:
        """Read the daemon's status; print the link's port when it is first known."""
        status = None if self._is_said else read_status(self._state)
        port = (status or {}).get("telemetry", {}).get("port")
        if port:
            self._is_said = True
            sys.stderr.write(f"hil: the daemon's link is open on TCP port {port}\n")


def run(
    config: Path, plant_file: Path, total_s: float, meter: Meter, disturb: Disturb = nothing
) -> Outcome:
    """Start plant and daemon, wait for the motion to end, stop both.

    `disturb` is called a few times a second while they run.

    Raises
    ------
    LiveError with the name of the process that failed and the end of its log.
    """
    folder = config.parent
    state = folder / "state" / "status.json"
    state.unlink(missing_ok=True)
    before = set((folder / "recording").glob("*.mcap"))
    began_s = time.monotonic()
    with process_of("plant", ["-m", "hil.devices", str(plant_file)], folder) as plant:
        wait_ready(plant, folder)
        with process_of("daemon", ["-m", "fsw", "run", "--cold", str(config)], folder) as daemon:
            _watch(plant, daemon, state, total_s, meter, folder, disturb)
            exit_code = stop_process(daemon, "daemon")
        stop_process(plant, "plant")
        output = plant.stdout.read() if plant.stdout is not None else ""
    closing = json.loads(output.strip().splitlines()[-1])
    recordings = tuple(sorted(set((folder / "recording").glob("*.mcap")) - before))
    if not recordings:
        raise LiveError(f"the daemon left no recording in {folder}; {_tail(folder, 'daemon')}")
    last = {message.topic: message.data for message in _messages(recordings, "/estimate", "/tm")}
    if "/estimate" not in last:
        raise LiveError(f"{recordings[-1]}: holds no estimate; {_tail(folder, 'daemon')}")
    return Outcome(
        recordings=recordings,
        final=json.loads(last["/estimate"]),
        status=json.loads(last["/tm"]),
        plant=closing,
        exit_code=exit_code,
        wall_s=time.monotonic() - began_s,
    )


def end_unrecorded(_severity: str, code: str, text: str) -> None:
    """End a run whose recording has failed. Raises LiveError."""
    raise LiveError(f"{code}: {text}")


@contextmanager
def process_of(name: str, arguments: list[str], folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a Python process with a log file; kill it if it still runs at the block's end."""
    with (folder / f"{name}.log").open("w", encoding="utf-8") as log:
        process = subprocess.Popen(
            tied([sys.executable, *arguments]),
            stdout=subprocess.PIPE if name == "plant" else log,
            stderr=log,
            text=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
            if process.stdout is not None:
                process.stdout.close()


@contextmanager
def started_plant(plant_file: Path, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Start the plant and wait until it is ready. Raises LiveError if it does not start."""
    with process_of("plant", ["-m", "hil.devices", str(plant_file)], folder) as plant:
        wait_ready(plant, folder)
        yield plant


def wait_ready(plant: subprocess.Popen[str], folder: Path) -> None:
    """Wait until the plant has simulated the truth. Raises LiveError if the plant ends before."""
    line = plant.stdout.readline() if plant.stdout is not None else ""
    if not line or not json.loads(line).get("ready"):
        raise LiveError(f"the plant did not start; {_tail(folder, 'plant')}")


def _watch(
    plant: subprocess.Popen[str],
    daemon: subprocess.Popen[str],
    state: Path,
    total_s: float,
    meter: Meter,
    folder: Path,
    disturb: Disturb,
) -> None:
    """Follow the daemon's status until `total_s` has passed. Raises LiveError if a process ends."""
    began_s = time.monotonic()
    first: tuple[int, int] | None = None
    said = ""
    while True:
        for name, process in (("plant", plant), ("daemon", daemon)):
            if process.poll() is not None:
                code = process.returncode
                raise LiveError(f"the {name} ended early ({code}); {_tail(folder, name)}")
        status = read_status(state)
        if status is not None and first is None:
            first = (int(status["t_ns"]), time.monotonic_ns())
            plant.send_signal(signal.SIGUSR2)  # the host receives
        if first is None:
            if time.monotonic() - began_s > START_TIMEOUT_S:
                raise LiveError(f"the daemon wrote no status; {_tail(folder, 'daemon')}")
        else:
            done_s = (time.monotonic_ns() - first[0]) * 1e-9
            wrong = trouble(status, time.monotonic_ns())
            if wrong and wrong != said:
                sys.stderr.write(f"hil: run: {wrong}\n")
            said = wrong
            meter.update(min(done_s, total_s), shown(status, wrong))
            disturb(done_s, plant.pid, daemon.pid)
            if done_s >= total_s:
                return
        time.sleep(POLL_S)


def trouble(status: Mapping[str, Any] | None, now_ns: int) -> str:
    """Return what is wrong: no new status, or nothing is recorded; empty: all is well."""
    if status is None:
        return ""
    if now_ns - int(status["t_ns"]) > STALE_NS:
        return f"no status from the daemon for more than {STALE_NS / 1e9:g} s"
    if status.get("recorder", {}).get("failing"):
        return f"nothing is recorded: {status['recorder']['failing']}"
    return ""


def shown(status: Mapping[str, Any] | None, wrong: str) -> Mapping[str, Any] | None:
    """Return the newest estimate's summary for the meter; it is not valid if something is wrong."""
    estimate: Mapping[str, Any] | None = None if status is None else status.get("estimate")
    if estimate is None or not wrong:
        return estimate
    return {**estimate, "valid": False, "reason": wrong}


def read_status(path: Path) -> dict[str, Any] | None:
    """Return the daemon's status; None if the file is missing or invalid."""
    try:
        status = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return status if isinstance(status, dict) and "t_ns" in status else None


def stop_process(process: subprocess.Popen[str], name: str) -> int:
    """End a process by SIGTERM; return its exit code. Raises LiveError if it does not end."""
    process.send_signal(signal.SIGTERM)
    try:
        return process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired as error:
        raise LiveError(f"the {name} did not end within {STOP_TIMEOUT_S} s of SIGTERM") from error


def _messages(recordings: Sequence[Path], *topics: str) -> Iterator[RecordedMessage]:
    """Yield the messages of some topics, part after part; a part is read up to where it is cut."""
    for part in recordings:
        with suppress(ConfigError):
            yield from messages(part, topics)


def events_of(recordings: Sequence[Path]) -> list[Event]:
    """Return the recorded events; a replay has no clock and cannot find the daemon's stalls."""
    return [Event(**json.loads(m.data)) for m in _messages(recordings, "/events")]


def estimate_by(recordings: Sequence[Path], end_ns: int) -> dict[str, Any]:
    """Return a run's last estimate whose time is at most `end_ns`.

    Raises
    ------
    LiveError if there is no such estimate.
    """
    last: dict[str, Any] | None = None
    for message in _messages(recordings, "/estimate"):
        values = json.loads(message.data)
        if values["t_ns"] <= end_ns:
            last = values
    if last is None:
        raise LiveError(f"{recordings[-1]}: holds no estimate of the motion")
    return last


def _tail(folder: Path, name: str) -> str:
    path = folder / f"{name}.log"
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return f"{path}: ...{text[-2000:]}"
