"""A process that ends too often is tried again after a minute, and the daemon says so."""

import json
import os

import pytest

from fsw.clock import MonotonicClock
from fsw.exchange.ring import RingReader, RingWriter
from fsw.loop.processes import MOST_RESTARTS, RESTARTS_NS, Child, lock_state
from fsw.loop.state_guard import StateGuard, close_to_others

SECOND_NS = 10**9


class Clock:
    def __init__(self) -> None:
        self.now = SECOND_NS

    def now_ns(self) -> int:
        return self.now


class Told:
    """Events and lines of the loop."""

    def __init__(self) -> None:
        self.events, self.lines, self.status = [], [], {}

    def put(self, event) -> None:
        self.events.append(event)

    def say(self, line, status) -> None:
        self.lines.append(line)
        self.status |= status


@pytest.fixture
def dying():
    """A service that ends at once, whenever it is started."""
    clock, told = Clock(), Told()
    child = Child(
        "service",
        "this",
        "nothing is recorded",
        (),
        (),
        RingWriter.create(1024),
        told,
        clock,
        told.say,
    )
    yield child, clock, told
    child.kill()


def end(child: Child) -> None:
    child._process.wait()
    child.watch()


def test_a_service_given_up_is_tried_again_after_a_minute_and_said_everywhere(dying):
    child, clock, told = dying
    for _ in range(MOST_RESTARTS + 1):
        assert not child.gave_up
        end(child)
        clock.now += SECOND_NS
    assert child.gave_up
    assert told.lines == [told.events[-1].text]
    assert "nothing is recorded until the next attempt in 60 s" in told.lines[0]
    assert told.status == {"processes": {"service": {"gave_up": True, "ends": 6}}}
    before = child.pid
    clock.now += RESTARTS_NS - 2 * SECOND_NS
    assert not child.watch()
    assert child.pid == before
    clock.now += SECOND_NS
    child.watch()
    assert child.pid != before
    assert not child.gave_up
    for _ in range(MOST_RESTARTS + 1):
        end(child)
    assert len(told.lines) == 2, "also the next time"


def test_a_process_that_hangs_is_named_once_and_again_when_it_hangs_again():
    ring, clock, told = RingWriter.create(1024), Clock(), Told()
    reader = RingReader(os.dup(ring.fd))
    own = ("--bind", "127.0.0.1", "0")
    child = Child("service", "http.server", "no recording", own, (), ring, told, clock, told.say)
    try:
        for hangs in (1, 2):
            assert ring.push(1, b"message")
            for _ in range(20):
                clock.now += SECOND_NS
                child.watch()
            assert [str(child.pid) in line for line in told.lines] == [True] * hangs
            assert not child.watch()
            assert list(reader.read())
            assert child.watch(), "it reads again"
    finally:
        child.kill()


def test_the_status_file_and_the_terminal_say_what_no_service_can(tmp_path, capfd):
    (tmp_path / "status.json").write_text(json.dumps({"ticks": 7, "processes": {}}))
    guard = StateGuard(tmp_path, lock_state(tmp_path, MonotonicClock()))
    guard._tell("service process ended", {"processes": {"service": {"gave_up": True}}})
    guard.close()
    status = json.loads((tmp_path / "status.json").read_text())
    assert status == {"ticks": 7, "processes": {"service": {"gave_up": True}}}
    assert capfd.readouterr().err == "fsw: service process ended\n"


def test_the_lock_of_a_removed_state_directory_is_taken_again(tmp_path):
    state = tmp_path / "state"
    guard = StateGuard(state, lock_state(state, MonotonicClock()))
    (state / "loop.lock").unlink()
    state.rmdir()
    guard.look()
    assert guard.faults() == []
    with pytest.raises(OSError, match="another daemon"):
        lock_state(state, MonotonicClock())
    (state / "loop.lock").unlink()
    lock_state(state, MonotonicClock())
    guard.look()
    guard.look()
    assert len(guard.faults()) == 1, "once"
    guard.close()


def test_a_state_directory_that_cannot_be_made_again_is_reported_once_each_time(tmp_path):
    state = tmp_path / "state"
    guard = StateGuard(state, lock_state(state, MonotonicClock()))
    for _ in range(2):
        (state / "loop.lock").unlink()
        state.rmdir()
        state.write_text("a file in its place")
        for _ in range(4):
            guard.look()
        ((code, text),) = guard.faults()
        assert code == "STATE_REMOVED"
        assert text.startswith(f"{state}: ")
        state.unlink()
        guard.look()
        assert (state / "loop.lock").exists()
    assert guard.faults() == []
    guard.close()


@pytest.mark.parametrize("umask", [0, 0o022, 0o077])
def test_what_is_written_is_closed_to_others(tmp_path, umask):

    state = tmp_path / "state"
    state.mkdir(0o755)
    before = os.umask(umask)
    try:
        close_to_others(state)
        (state / "log").write_text("")
        (state / "folder").mkdir()
        for path in (state, state / "log", state / "folder"):
            assert path.stat().st_mode & 0o007 == 0
            assert path.stat().st_mode & 0o020 == 0
        assert os.umask(0o777) & umask == umask, "no permission is given that the user withholds"
    finally:
        os.umask(before)
