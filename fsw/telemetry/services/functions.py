"""Service 8: functions that the loop, the recorder or the application carries out."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from fsw.errors import CommandError
from fsw.estimators.parameter_verdicts import in_words
from fsw.messages.commands import CommandName, Reply
from fsw.telemetry.dictionary.codes import METHOD, Error, Mode
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.services.loop_commands import Order

BODIES = {0: [], 1: ["base"], 2: ["target"], 3: ["base", "target"]}

# action of a monitor -> telecommand of the same effect, its arguments, the loop's command
ACTIONS: dict[str, tuple[str, str, CommandName | None]] = {
    "safe": ("SET_MODE", "mode=SAFE", None),
    "standby": ("STOP_IDENTIFICATION", "", CommandName.REST),
    "reset_estimator": ("RESET_ESTIMATOR", "", CommandName.RESET),
    "abort_batch": ("ABORT_BATCH", "", CommandName.ABORT_BATCH),
}


class Functions:
    """Handles the functions of identification, batch jobs, state, recorder and mode."""

    def __init__(self, context: TelemetryContext) -> None:
        self._context = context
        self._loop, self._mode_machine = context.loop, context.mode_machine
        self._recording = context.host.recording

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of these functions."""
        simple = {
            "STOP_IDENTIFICATION": CommandName.REST,
            "RESET_ESTIMATOR": CommandName.RESET,
            "SETTLE_ESTIMATOR": CommandName.FINISH,
            "SAVE_STATE": CommandName.SAVE_STATE,
            "RESTORE_STATE": CommandName.RESTORE_STATE,
            "ABORT_BATCH": CommandName.ABORT_BATCH,
            "ADOPT_RESULT": CommandName.ADOPT,
            "RESTART": CommandName.RESTART,
        }
        found: dict[str, Handler] = {
            name: partial(self._simple, command) for name, command in simple.items()
        }
        return found | {
            "START_IDENTIFICATION": self._start,
            "REPORT_DIAGNOSIS": self._diagnose,
            "RUN_BATCH": self._run_batch,
            "RUN_PLAN": self._run_plan,
            "SET_MODE": self._set_mode,
            "REC_START": lambda _: partial(_recorder, self._recording.start),
            "REC_STOP": lambda _: partial(_recorder, self._recording.stop),
        }

    def go_safe(self) -> None:
        """Enter SAFE: pause the estimator and abort the batch job."""
        self._mode_machine.latch_safe()
        orders: list[tuple[Order]] = [((CommandName.REST, {}),), ((CommandName.ABORT_BATCH, {}),)]
        for order in orders:
            try:
                self._loop.order(None, order)
            except TcError:
                continue  # the ring is full because the loop reads no commands

    def act(self, action: str, who: str) -> None:
        """Carry out an action of a monitor or of a timer, and log it as a command.

        Parameters
        ----------
        action : a label of MONITOR_ACTION in lower case
        who : name of the monitor or timer
        """
        name, arguments, command = ACTIONS[action]
        executor = self._context.executor
        record = executor.open_record(who, name, arguments)
        if command is None:
            self.go_safe()
            executor.close_record(record, None)
            return
        try:
            self._loop.order(record, [(command, {})])
        except TcError as error:
            executor.close_record(record, error)

    def _simple(self, name: CommandName, request: Request) -> Action:
        return partial(self._loop.order, request, [(name, {})])

    def _bodies(self, request: Request) -> list[str]:
        return BODIES[request.whole("unknown")] or list(self._context.config.unknown)

    def _start(self, request: Request) -> Action:
        orders: list[Order] = [
            (CommandName.CONFIGURE, {"unknown": self._bodies(request)}),
            (CommandName.RESUME, {}),
        ]
        return partial(self._loop.order, request, orders)

    def _diagnose(self, request: Request) -> Action:
        def then(reply: Reply) -> None:
            self._context.down.send("diagnosis", _diagnosis(reply.data))

        return partial(self._loop.order, request, [(CommandName.REPORT, {})], then)

    def _run_batch(self, request: Request) -> Action:
        method = METHOD.labels[request.whole("method")].lower()
        bodies = self._bodies(request)
        last_s = request.number("last_s") or self._context.parameter("batch_last_s")
        args: dict[str, object] = {"method": method, "unknown": bodies, "last_s": last_s or None}
        return self._job(request, (CommandName.RUN_BATCH, args), method, tuple(bodies))

    def _run_plan(self, request: Request) -> Action:
        args: dict[str, object] = {
            "duration_s": request.number("duration_s"),
            "starts": request.whole("starts"),
            "seed": request.whole("seed"),
        }
        return self._job(request, (CommandName.RUN_PLAN, args), "plan", ())

    def _job(self, request: Request, order: Order, method: str, bodies: tuple[str, ...]) -> Action:
        if self._mode_machine.mode is Mode.BATCH:
            raise TcError(Error.BUSY, text="a batch job is running")

        def act() -> Done:
            self._context.latest.requested_job(method, bodies)
            return self._loop.order(request, [order])

        return act

    def _set_mode(self, request: Request) -> Action:
        wanted = Mode(request.whole("mode"))
        if self._mode_machine.mode is Mode.BOOT:
            raise TcError(Error.WRONG_MODE, 1, Mode.BOOT, "the loop is not up yet")
        return partial(self._go, request, wanted)

    def _go(self, request: Request, wanted: Mode) -> Done:
        if wanted is Mode.SAFE:
            self.go_safe()
            return Done.NOW

        def then(_reply: Reply) -> None:
            self._mode_machine.leave_safe()

        name = CommandName.RESUME if wanted is Mode.IDENTIFY else CommandName.REST
        return self._loop.order(request, [(name, {})], then)


def _recorder(act: Callable[[], None]) -> Done:
    try:
        act()
    except CommandError as error:
        known = error.code in Error.__members__
        raise TcError(Error[error.code] if known else Error.FAILED, text=str(error)) from error
    return Done.NOW


def _diagnosis(data: Any) -> dict[str, object]:  # noqa: ANN401
    lag, verdict = data.get("innovation_lag1", {}), data.get("verdict", data.get("reason", ""))
    return {
        "duration_s": data.get("duration_s", 0.0),
        "blocks": data.get("blocks", 0),
        "valid": bool(data.get("valid", False)),
        "noise_ratio": data.get("noise_ratio", 0.0),
        "innovation_lag1": lag.get("correlation", 0.0),
        "innovation_lag1_bound": lag.get("bound", 0.0),
        "verdict": "; ".join(verdict.values()) if isinstance(verdict, Mapping) else str(verdict),
        "parameters": "; ".join(
            f"{body}: {in_words(words)}" for body, words in data.get("parameters", {}).items()
        ),
    }
