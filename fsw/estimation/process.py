"""The estimation process: reads the loop's traffic from a ring and publishes estimates.

The loop process starts `python -m fsw.estimation.process` with two inherited rings. The
process ends when the loop ends, also when the loop is killed. After a crash, the next estimation
process continues from the newest checkpoint and reads the records that wait in the ring.
"""

import argparse
import gc
import os
import select
import signal
import sys

from fsw.clock import Clock, MonotonicClock, boot_id
from fsw.config import Config
from fsw.estimation.estimation import Estimation
from fsw.exchange.checkpoint_store import CheckpointStore, identity_of
from fsw.exchange.restart import judge
from fsw.exchange.ring import RingReader, RingWriter
from fsw.exchange.ringlink import TO_SERVICE, Kind, RingSink, handed_down, message_of
from fsw.exchange.sinks import BatchEnd, Sink
from fsw.exchange.tied import end_with
from fsw.messages import Event
from fsw.scheduler import realtime

LOOK_MS = 500  # longest wait for the loop's wake-up call


def go_on(
    estimation: Estimation, config: Config, clock: Clock, sink: Sink, since_ns: int, *, again: bool
) -> bool:
    """Continue from the newest usable checkpoint, if any; report refused ones as events.

    Parameters
    ----------
    since_ns : use only checkpoints of this boot that are not older [ns]; 0: use all
    again : whether an earlier estimation process of the same loop has ended
    """
    directory = config.resolve(config.service.state_directory)
    try:
        store = CheckpointStore(directory, identity_of(config))
    except OSError as error:
        text = f"{config.robot.urdf}: {error.strerror or error}"
        sink.put(Event(clock.now_ns(), "medium", "CHECKPOINT_REFUSED", text))
        return False
    good, refused = store.read()
    for text in refused:
        sink.put(Event(clock.now_ns(), "medium", "CHECKPOINT_REFUSED", text))
    boot, hold_s = boot_id(), config.service.checkpoint_hold_s
    for checkpoint in good:
        if since_ns and (checkpoint.boot_id != boot or checkpoint.snapshot.t_ns < since_ns):
            continue
        found = judge(checkpoint, boot, clock.now_ns(), hold_s)
        if estimation.restart(found, recorded=not again):
            return True
    return False


def work_off(estimation: Estimation, ring: RingReader) -> bool:
    """Process the records that wait in the ring; return False after the record of the end."""
    for record in ring.read(once=True):
        if record.kind == Kind.END:
            return False
        message = message_of(record)
        if message is not None:
            estimation.put(message)
        if isinstance(message, BatchEnd):
            ring.note(estimation.aligner.deadline_ns or 0, estimation.aligner.grid_ns or 0)
    return True


def serve(estimation: Estimation, ring: RingReader, wake: int, parent: int, clock: Clock) -> bool:
    """Process the loop's traffic until its end; return False if the loop has died."""
    poll = select.poll()
    poll.register(wake, select.POLLIN)
    going = work_off(estimation, ring)  # traffic of the start-up
    estimation.counts_from_ns = clock.now_ns()
    while os.getppid() == parent:
        if not (going and work_off(estimation, ring)):
            return True
        if poll.poll(LOOK_MS):
            os.eventfd_read(wake)
    return False


def main(argv: list[str]) -> int:
    """Run the estimation process."""
    parser = argparse.ArgumentParser(prog="fsw.estimation.process", description=__doc__)
    parser.add_argument("--ring", type=int, required=True, help="descriptor of the loop's ring")
    parser.add_argument("--wake", type=int, required=True, help="descriptor of the loop's call")
    parser.add_argument("--down", type=int, required=True, help="descriptor of the service's ring")
    parser.add_argument("--config", type=int, required=True, help="descriptor of the configuration")
    parser.add_argument("--parent", type=int, required=True, help="process of the loop")
    parser.add_argument("--since", type=int, default=0, help="no older checkpoint counts [ns]")
    parser.add_argument("--resume", action="store_true", help="take over from one that has died")
    arguments = parser.parse_args(argv)
    end_with(arguments.parent)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the loop's end is what ends the estimation
    config = handed_down(arguments.config)
    if arguments.resume and config.telemetry is not None:
        from fsw.telemetry.tables.effective import effective_config

        config = effective_config(config.as_read())  # tables may have been changed since the start
    clock = MonotonicClock()
    sink = RingSink(RingWriter(arguments.down), TO_SERVICE)
    estimation = Estimation(config, clock.now_ns, sink)
    ring = RingReader(arguments.ring)
    if arguments.resume:
        text = f"process {os.getpid()}"
        sink.put(Event(clock.now_ns(), "medium", "ESTIMATION_BACK", text))
        if ring.notes[1]:
            estimation.aligner.resume(ring.notes[1])
    since_ns, again = arguments.since, arguments.resume
    if config.service.checkpoint_period_s is not None and (again or not since_ns):
        go_on(estimation, config, clock, sink, since_ns, again=again)
    settings, keys = config.scheduler, ("estimation_cpu", "estimation_priority")
    for text in realtime.prepare(settings.estimation_cpu, settings.estimation_fifo, keys):
        sink.put(Event(clock.now_ns(), "low", "REALTIME", text))
    gc.freeze()
    if serve(estimation, ring, arguments.wake, arguments.parent, clock):
        estimation.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
