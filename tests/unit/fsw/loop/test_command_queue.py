import pytest

from fsw.loop.command_queue import QUEUE_LIMIT, CommandQueue
from fsw.messages.commands import Code, Command, CommandName
from tests.support.loop_cases import FakeEstimator, KeepSink, make_estimate


class Bench:
    def __init__(self) -> None:
        self.estimator, self.sink = FakeEstimator(), KeepSink()
        self.dispatcher = CommandQueue(self.estimator, self.sink)

    def tell(self, name: CommandName, number: int = 1, **args) -> Code:
        self.dispatcher.submit(Command(name=name, id=number, args=args))
        self.estimates = self.dispatcher.run(1000, 5, 7)
        return self.sink.replies[-1].code


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_nothing_happens_before_the_tick_boundary(bench: Bench):
    bench.dispatcher.submit(Command(name=CommandName.RESET))
    assert bench.estimator.calls == []
    bench.dispatcher.run(0, 0)
    assert bench.estimator.calls == ["reset"]


def test_finish_ends_due_work_first_and_gives_an_estimate(bench: Bench):
    assert bench.tell(CommandName.FINISH) is Code.ACCEPTED
    assert bench.estimator.calls == ["work", "finish"]
    assert len(bench.estimates) == 1


class Slow(FakeEstimator):
    """Settles in four units."""

    def finishing(self):
        for unit in range(3):
            self.calls.append(f"unit {unit}")
            yield
        self.calls.append("finish")
        return make_estimate(0, 1)


def test_a_long_command_takes_several_ticks_and_nothing_is_begun_meanwhile():
    estimator, sink = Slow(), KeepSink()
    queue = CommandQueue(estimator, sink)
    queue.submit(Command(name=CommandName.FINISH, id=1))
    queue.submit(Command(name=CommandName.RESET, id=2))
    for tick in range(3):
        assert queue.run(tick, 5 + tick, 7 + tick, has_time=lambda: False) == []
        assert queue.is_busy
        assert estimator.calls == [f"unit {k}" for k in range(tick + 1)]
        assert sink.replies == []
    assert len(queue.run(3, 8, 10, held=True, has_time=lambda: False)) == 1
    assert not queue.is_busy
    assert [reply.id for reply in sink.replies] == [1]
    assert sink.commands[0] | {"args": None} == {
        "command": "finish",
        "id": 1,
        "args": None,
        "next_window": 5,
        "clean_window": 7,
    }
    assert queue.run(4, 9, 11, held=True) == []  # windows have closed meanwhile: they come first
    assert estimator.calls[-1] == "finish"
    queue.run(5, 9, 11)
    assert estimator.calls[-1] == "reset"


def test_what_a_checkpoint_carries_is_the_choice_of_unknowns_and_no_table(bench: Bench):
    given: list = []
    sink = KeepSink()
    dispatcher = CommandQueue(
        bench.estimator, sink, reconfigure=lambda c: given.append(dict(c)) or bench.estimator
    )
    orders = ({"noise": {"joints": {}}}, {"unknown": ["base"]}, {"estimator": {"settle_blocks": 3}})
    for changes in orders:
        dispatcher.submit(Command(name=CommandName.CONFIGURE, args=changes))
    dispatcher.run(0, 0)
    assert given == list(orders)
    assert dispatcher.changes == [{"unknown": ["base"]}]


def test_an_applied_command_is_recorded_with_its_place(bench: Bench):
    bench.tell(CommandName.RESET, 9)
    place = {"next_window": 5, "clean_window": 7}
    assert bench.sink.commands == [{"command": "reset", "id": 9, "args": {}} | place]


@pytest.mark.parametrize("name", [CommandName.RESET, CommandName.RESUME, CommandName.REST])
def test_windows_of_before_a_new_beginning_are_left_out(bench: Bench, name: CommandName):
    bench.tell(name)
    assert bench.dispatcher.first_window == (0 if name is CommandName.REST else 7)


def test_a_refused_command_is_not_recorded(bench: Bench):
    assert bench.tell(CommandName.RESTORE_STATE) is Code.NO_STATE
    assert bench.sink.commands == []


def test_a_full_queue_refuses_at_once(bench: Bench):
    for k in range(QUEUE_LIMIT + 1):
        bench.dispatcher.submit(Command(name=CommandName.RESET, id=k))
    assert [r.code for r in bench.sink.replies] == [Code.QUEUE_FULL]


def test_stop_is_a_request_to_the_loop(bench: Bench):
    assert bench.tell(CommandName.STOP) is Code.ACCEPTED
    assert bench.dispatcher.stop_requested


def test_adopt_needs_its_result_and_records_it_for_a_replay(bench: Bench):
    assert bench.tell(CommandName.ADOPT) is Code.NO_RESULT
    assert bench.tell(CommandName.ADOPT, result={"mean": [1.0]}) is Code.ACCEPTED
    assert bench.estimator.adopted == [{"mean": [1.0]}]
    assert bench.sink.commands[-1]["args"] == {"result": {"mean": [1.0]}}


@pytest.mark.parametrize("name", [CommandName.RUN_BATCH, CommandName.ABORT_BATCH])
def test_the_loop_refuses_batch_jobs(bench: Bench, name: CommandName):
    assert bench.tell(name) is Code.NOT_SUPPORTED
    assert bench.sink.commands == []


def test_planned_commands_apply_right_before_their_window(bench: Bench):
    bench.dispatcher.plan(3, Command(name=CommandName.RESET))
    bench.dispatcher.before_window(2, 0)
    assert bench.estimator.calls == []
    bench.dispatcher.before_window(3, 0)
    assert bench.estimator.calls == ["reset"]


class Breaking(FakeEstimator):
    """Everything a command asks of it raises; nobody foresaw that."""

    def _raise(self, *_arguments) -> None:
        raise RuntimeError("unforeseen " + "x" * 5000)

    finishing = adopt = restore = snapshot = report = estimate = _raise
    blocks = ()


COMMANDS = [
    (CommandName.FINISH, {}),
    (CommandName.REPORT, {}),
    (CommandName.SAVE_STATE, {}),
    (CommandName.ADOPT, {"result": {}}),
    (CommandName.CONFIGURE, {"unknown": ["base"]}),
]


@pytest.mark.parametrize(("name", "args"), COMMANDS)
def test_an_error_nobody_foresaw_fails_the_command_and_the_loop_continues(name, args):
    estimator, sink = Breaking(), KeepSink()
    dispatcher = CommandQueue(estimator, sink, reconfigure=estimator._raise)
    dispatcher.submit(Command(name=name, id=7, args=args))
    assert dispatcher.run(1000, 5, 7) == []
    (reply,) = sink.replies
    assert (reply.id, reply.accepted, reply.code) == (7, False, Code.FAILED)
    assert "unforeseen" in reply.text
    assert len(reply.text) < 1000
    assert sink.codes == ["COMMAND_FAILED"]
    assert sink.commands == []
    dispatcher.submit(Command(name=CommandName.RESET))
    dispatcher.run(1000, 5, 7)
    assert sink.replies[-1].code is Code.ACCEPTED


@pytest.mark.parametrize("name", [CommandName.FINISH, CommandName.ADOPT])
def test_an_estimator_left_in_the_middle_of_a_failed_command_returns_to_its_prior(name):
    estimator = Breaking()
    dispatcher = CommandQueue(estimator, KeepSink())
    dispatcher.submit(Command(name=name, args={"result": {}}))
    dispatcher.run(0, 0)
    assert estimator.calls[-1] == "reset"


def test_no_memory_is_no_failed_command(bench: Bench):
    def full() -> None:
        raise MemoryError

    bench.estimator.finishing = full
    with pytest.raises(MemoryError):
        bench.tell(CommandName.FINISH)
