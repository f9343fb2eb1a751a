"""Applies commands between two windows."""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

from fsw.errors import CommandError, ConfigError, EstimatorError, unforeseen
from fsw.exchange.restart import Adopting, put_back, take
from fsw.exchange.sinks import AppliedCommand, Sink
from fsw.messages import Estimate, Event, Snapshot
from fsw.messages.commands import (
    Code,
    Command,
    CommandName,
    Reply,
)

KEPT_AFTER = (
    CommandName.RESET,
    CommandName.ADOPT,
    CommandName.REST,
    CommandName.RESUME,
    CommandName.CONFIGURE,
    CommandName.SAVE_STATE,
    CommandName.RESTORE_STATE,
)
# after these, the estimator restarts at its prior and ignores windows that began before them
ANEW = (CommandName.RESET, CommandName.RESUME, CommandName.CONFIGURE)
# if one of these fails, the estimator may be left between its old and its new state
UNFINISHED = (CommandName.FINISH, CommandName.ADOPT, CommandName.RESTORE_STATE)


class Resettable(Protocol):
    """The part of an estimator that commands use."""

    def finish(self) -> Estimate:
        """Re-linearise until the estimate has converged; return the estimate."""
        ...

    def reset(self) -> None:
        """Return to the prior."""
        ...


@runtime_checkable
class Reporting(Protocol):
    """An estimator that can diagnose its estimate."""

    def report(self) -> Mapping[str, Any]:
        """Return the diagnosis as plain values, or raise EstimatorError (no valid covariance)."""
        ...


Reconfigure = Callable[[Mapping[str, Any]], Resettable]


class Dispatcher:
    """Applies each command completely between two windows.

    The sink receives every applied command with the index of the next window and with the values
    that are needed to apply the command again. A replay applies it before the same window.
    """

    def __init__(
        self,
        estimator: Resettable,
        sink: Sink,
        *,
        reconfigure: Reconfigure | None = None,
        identifying: bool = True,
    ) -> None:
        self._estimator, self._sink = estimator, sink
        self._reconfigure = reconfigure
        self.identifying = identifying  # whether windows reach the estimator
        self.first_window = 0  # index of the first window that reaches the estimator
        self.changes: list[Mapping[str, Any]] = []  # changes of the unknowns, for checkpoints
        self._planned: deque[tuple[int, int, Command]] = deque()
        self.saved: Snapshot | None = None  # the state that RESTORE_STATE restores
        self.checkpoint_due = False  # a command has changed the state or requested a checkpoint

    @property
    def is_idle(self) -> bool:
        """Whether no window reaches the estimator and no planned command can change that."""
        return not (self.identifying or self._planned)

    def plan(self, window: int, command: Command, clean_window: int = 0) -> None:
        """Plan a recorded command to be applied before window `window`; call in recorded order.

        `clean_window` is the index of the first window that began after the command.
        """
        self._planned.append((window, clean_window, command))

    def before_window(self, index: int, now_ns: int) -> list[Estimate]:
        """Apply the planned commands up to window `index`; return the estimates they gave."""
        estimates = []
        while self._planned and self._planned[0][0] <= index:
            window, clean_window, command = self._planned.popleft()
            estimate = self.apply(command, now_ns, window, clean_window)
            if estimate is not None:
                estimates.append(estimate)
        return estimates

    def apply(
        self, command: Command, now_ns: int, next_window: int, clean_window: int = 0
    ) -> Estimate | None:
        """Apply one command and send its reply; return the estimate it gives, or None.

        Parameters
        ----------
        next_window : index of the window that closes next
        clean_window : index of the first window that begins from now on
        """
        data: Mapping[str, Any] = {}
        try:
            if command.name is CommandName.REPORT:
                data = self.diagnose()
            args, estimate = self._execute(command, now_ns)
        except CommandError as error:
            self._answer(command, Code(error.code), str(error))
            return None
        except EstimatorError as error:
            self._answer(command, Code.ESTIMATOR, str(error))
            return None
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - no command ends the loop
            self._fail(command, error, now_ns)
            return None
        if command.name in ANEW:
            self.first_window = clean_window
        record = {"command": str(command.name), "id": command.id, "args": args}
        windows = {"next_window": next_window, "clean_window": clean_window}
        self._sink.put(AppliedCommand(now_ns, record | windows))
        self._answer(command, Code.ACCEPTED, "", data)
        return estimate

    def _fail(self, command: Command, error: Exception, now_ns: int) -> None:
        """Reply to a command with an unforeseen error; reset an estimator left unfinished."""
        text = unforeseen(error)
        if command.name in UNFINISHED:
            self._estimator.reset()
            text += "; the estimator is back at its prior"
        event = Event(now_ns, "high", "COMMAND_FAILED", f"{command.name}: {text}")
        self._sink.put(event)
        self._answer(command, Code.FAILED, text)

    def diagnose(self) -> Mapping[str, Any]:
        """Return the estimator's diagnosis of its estimate as plain values.

        Raises
        ------
        CommandError if this estimator has no report; EstimatorError without a valid covariance.
        """
        if not isinstance(self._estimator, Reporting):
            raise CommandError(Code.NOT_SUPPORTED, "this estimator gives no report")
        return self._estimator.report()

    def _execute(self, command: Command, now_ns: int) -> tuple[Mapping[str, Any], Estimate | None]:
        name = command.name
        estimate: Estimate | None = None
        args: Mapping[str, Any] = command.args
        self.checkpoint_due |= name in KEPT_AFTER
        if name is CommandName.RESET:
            self._estimator.reset()
        elif name is CommandName.SAVE_STATE:
            self.saved = take(self._estimator, now_ns)
            if self.saved is None:
                raise CommandError(Code.NOT_SUPPORTED, "this estimator has no state to save")
        elif name is CommandName.RESTORE_STATE:
            if self.saved is None:
                raise CommandError(Code.NO_STATE, "nothing was saved or restored before")
            estimate = put_back(self._estimator, self.saved)
        elif name is CommandName.FINISH:
            estimate = self._estimator.finish()
        elif name in (CommandName.RUN_BATCH, CommandName.ABORT_BATCH):
            raise CommandError(Code.NOT_SUPPORTED, "batch jobs belong to the service process")
        elif name is CommandName.ADOPT:
            args = {"result": self._adopt(command)}
        elif name in (CommandName.REST, CommandName.RESUME):
            self.identifying = name is CommandName.RESUME
        elif name is CommandName.CONFIGURE:
            self.configure(command.args)
        return args, estimate

    def configure(self, changes: Mapping[str, Any]) -> None:
        """Restart at the prior with a changed configuration. Raises CommandError.

        Changed tables of noise, robot and settings are stored on disk and hold at the next start.
        A checkpoint carries only the choice of unknowns: it must not restore a table that has been
        replaced since.
        """
        if self._reconfigure is None:
            raise CommandError(Code.NOT_SUPPORTED, "no configuration can be changed here")
        try:
            self._estimator = self._reconfigure(changes)
        except ConfigError as error:
            raise CommandError(Code.BAD_ARGUMENT, str(error)) from error
        if "unknown" in changes:
            self.changes.append({"unknown": changes["unknown"]})
        self.saved = None

    def _adopt(self, command: Command) -> Mapping[str, Any]:
        result = command.args.get("result")
        if result is None:
            raise CommandError(Code.NO_RESULT, "a result must come with the command")
        if not isinstance(self._estimator, Adopting):
            raise CommandError(Code.NOT_SUPPORTED, "this estimator adopts no batch result")
        self._estimator.adopt(result)
        return dict(result)

    def _answer(
        self, command: Command, code: Code, text: str, data: Mapping[str, Any] | None = None
    ) -> None:
        self._sink.put(
            Reply(
                id=command.id,
                command=str(command.name),
                accepted=code is Code.ACCEPTED,
                code=code,
                text=text,
                data=data or {},
            )
        )
