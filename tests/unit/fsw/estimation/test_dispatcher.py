import pytest

from fsw.estimation.dispatcher import Dispatcher
from fsw.messages.commands import Code, Command, CommandName
from tests.support.loop_cases import FakeEstimator, KeepSink


class Bench:
    def __init__(self) -> None:
        self.estimator, self.sink = FakeEstimator(), KeepSink()
        self.dispatcher = Dispatcher(self.estimator, self.sink)

    def tell(self, name: CommandName, number: int = 1, **args) -> Code:
        command = Command(name=name, id=number, args=args)
        self.estimate = self.dispatcher.apply(command, 1000, 5, 7)
        return self.sink.replies[-1].code


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_finish_gives_an_estimate(bench: Bench):
    assert bench.tell(CommandName.FINISH) is Code.ACCEPTED
    assert bench.estimator.calls == ["finish"]
    assert bench.estimate is not None


def test_what_a_checkpoint_carries_is_the_choice_of_unknowns_and_no_table(bench: Bench):
    given: list = []
    sink = KeepSink()
    dispatcher = Dispatcher(
        bench.estimator, sink, reconfigure=lambda c: given.append(dict(c)) or bench.estimator
    )
    orders = ({"noise": {"joints": {}}}, {"unknown": ["base"]}, {"estimator": {"settle_blocks": 3}})
    for changes in orders:
        dispatcher.apply(Command(name=CommandName.CONFIGURE, args=changes), 0, 0)
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


@pytest.mark.parametrize("name", [CommandName.STOP, CommandName.RESTART])
def test_what_ends_the_loop_is_answered_here(bench: Bench, name: CommandName):
    assert bench.tell(name) is Code.ACCEPTED
    assert bench.estimator.calls == []


def test_adopt_needs_its_result_and_records_it_for_a_replay(bench: Bench):
    assert bench.tell(CommandName.ADOPT) is Code.NO_RESULT
    assert bench.tell(CommandName.ADOPT, result={"mean": [1.0]}) is Code.ACCEPTED
    assert bench.estimator.adopted == [{"mean": [1.0]}]
    assert bench.sink.commands[-1]["args"] == {"result": {"mean": [1.0]}}


@pytest.mark.parametrize("name", [CommandName.RUN_BATCH, CommandName.ABORT_BATCH])
def test_batch_jobs_are_refused_here(bench: Bench, name: CommandName):
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

    finish = adopt = restore = snapshot = report = estimate = _raise
    blocks = ()


COMMANDS = [
    (CommandName.FINISH, {}),
    (CommandName.REPORT, {}),
    (CommandName.SAVE_STATE, {}),
    (CommandName.ADOPT, {"result": {}}),
    (CommandName.CONFIGURE, {"unknown": ["base"]}),
]


@pytest.mark.parametrize(("name", "args"), COMMANDS)
def test_an_error_nobody_foresaw_fails_the_command_and_no_more(name, args):
    estimator, sink = Breaking(), KeepSink()
    dispatcher = Dispatcher(estimator, sink, reconfigure=estimator._raise)
    assert dispatcher.apply(Command(name=name, id=7, args=args), 1000, 5, 7) is None
    (reply,) = sink.replies
    assert (reply.id, reply.accepted, reply.code) == (7, False, Code.FAILED)
    assert "unforeseen" in reply.text
    assert len(reply.text) < 1000
    assert sink.codes == ["COMMAND_FAILED"]
    assert sink.commands == []
    dispatcher.apply(Command(name=CommandName.RESET), 1000, 5, 7)
    assert sink.replies[-1].code is Code.ACCEPTED


@pytest.mark.parametrize("name", [CommandName.FINISH, CommandName.ADOPT])
def test_an_estimator_left_in_the_middle_of_a_failed_command_returns_to_its_prior(name):
    estimator = Breaking()
    dispatcher = Dispatcher(estimator, KeepSink())
    dispatcher.apply(Command(name=name, args={"result": {}}), 0, 0)
    assert estimator.calls[-1] == "reset"


def test_no_memory_is_no_failed_command(bench: Bench):
    def full() -> None:
        raise MemoryError

    bench.estimator.finish = full
    with pytest.raises(MemoryError):
        bench.tell(CommandName.FINISH)
