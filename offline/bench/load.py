"""Run the process that sends frames or bytes to the readers of the bench."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from fsw.exchange.tied import module_command


@contextmanager
def sender(
    kind: str, place: str, rate_hz: float, seconds: float
) -> Iterator[subprocess.Popen[str]]:
    """Run a sender while the block runs, and terminate it at the end."""
    command = [*module_command("offline.bench.send"), kind, place]
    with subprocess.Popen(
        [*command, str(rate_hz), str(seconds)],
        stdout=subprocess.PIPE,
        text=True,
        pass_fds=[int(place)] if kind == "line" else [],
    ) as process:
        try:
            yield process
        finally:
            process.terminate()


def sent_by(process: subprocess.Popen[str]) -> int:
    """Wait for a sender's end; return the number of frames or bytes that it has sent."""
    output, _ = process.communicate()
    return int(output)
