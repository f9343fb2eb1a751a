"""Service 20: on-board parameters; a telecommand sets all of its parameters or none."""

from functools import partial

from fsw.messages.commands import CommandName, Reply
from fsw.telemetry.dictionary import Parameter
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.services.loop_commands import Order
from fsw.telemetry.state.parameter_values import estimator_changes


class Parameters:
    """Reports and sets the on-board parameters."""

    def __init__(self, context: TelemetryContext) -> None:
        self._context, self._values = context, context.parameters
        if self._values.damaged:
            text = f"{self._values.damaged} stored generations cannot be read"
            context.report("PARAMETERS_CORRUPT", text)

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of this service's telecommands."""
        return {
            "REPORT_PARAMETERS": lambda request: partial(self._report, request.parameters),
            "SET_PARAMETERS": self._set,
        }

    def _report(self, parameters: tuple[tuple[Parameter, float], ...]) -> Done:
        for item, _ in parameters:
            values = {"n": 1, item.name: self._values.get(item.name)}
            self._context.down.send(f"parameter_{item.name}", values)
        return Done.NOW

    def _set(self, request: Request) -> Action:
        mode = self._context.mode_machine.mode
        for place, (item, _) in enumerate(request.parameters, start=2):
            if item.accepted_in and mode.name not in item.accepted_in:
                raise TcError(Error.WRONG_MODE, place, mode, f"{item.name} in {mode.name}")
        wanted = {**self._values.commanded}
        wanted |= {item.name: value for item, value in request.parameters}
        return partial(self._apply, request, wanted)

    def _apply(self, request: Request, wanted: dict[str, float]) -> Done:
        try:
            number = self._values.prepare(wanted)
        except OSError as error:
            raise TcError(Error.FAILED, text=f"cannot be kept: {error.strerror}") from error
        changed = {item.name: wanted[item.name] for item, _ in request.parameters}
        changes = estimator_changes(changed)
        if not changes:
            self._commit(number, wanted)
            return Done.NOW

        def then(_reply: Reply) -> None:
            self._commit(number, wanted)

        order: Order = (CommandName.CONFIGURE, {"estimator": changes})
        return self._context.loop.order(request, [order], then, self._values.store.discard)

    def _commit(self, number: int, wanted: dict[str, float]) -> None:
        try:
            self._values.commit(number, wanted)
        except OSError as error:
            raise TcError(Error.FAILED, text=f"cannot be kept: {error.strerror}") from error
        words = ", ".join(f"{name} {value:.6g}" for name, value in wanted.items())
        self._context.report("PARAMETERS_SET", words)
