"""Service 20: on-board parameters, set all or none, kept over a restart."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from fsw.config import Config
from fsw.messages.commands import CommandName, Reply
from fsw.telemetry.dictionary import DICTIONARY, Parameter
from fsw.telemetry.dictionary.codes import Error, Mode
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.executor import Action, Done, Handler, Report, Send
from fsw.telemetry.services.loop_commands import LoopCommands, Order
from fsw.telemetry.state.store import GenerationStore

ESTIMATOR = {  # parameter -> key of the section; forgetting 0 is the configuration's null
    "gate_probability": "gate_probability",
    "condition_limit": "condition_limit",
    "forgetting_time_s": "forgetting_time_s",
    "settle_blocks": "settle_blocks",
}
BY_NAME = {item.name: item for item in DICTIONARY.parameters}


def stored_values(store: GenerationStore) -> tuple[dict[str, float], int]:
    """Return the newest values that are good, and how many generations were not."""
    generations, damaged = store.read()
    for generation in generations:
        values = _parse(generation.content)
        if values is not None:
            return values, damaged
        damaged += 1
    return {}, damaged


def estimator_changes(values: Mapping[str, float]) -> dict[str, Any]:
    """Return what the parameters lay over the estimator's section."""
    changes: dict[str, Any] = {
        key: values[name] for name, key in ESTIMATOR.items() if name in values
    }
    if "forgetting_time_s" in changes:
        changes["forgetting_time_s"] = changes["forgetting_time_s"] or None
    if "settle_blocks" in changes:
        changes["settle_blocks"] = int(changes["settle_blocks"])
    return changes


def _parse(content: bytes) -> dict[str, float] | None:
    try:
        document = json.loads(content)
    except ValueError:
        return None
    if not isinstance(document, dict):
        return None
    for name, value in document.items():
        item = BY_NAME.get(name)
        if item is None or not isinstance(value, int | float):
            return None
        if not item.minimum <= value <= item.maximum:
            return None
    return {name: float(value) for name, value in document.items()}


class Parameters:
    """Values in use: set by telecommand, else the configuration's, else the dictionary's."""

    def __init__(
        self,
        config: Config,
        store: GenerationStore,
        loop: LoopCommands,
        mode: Callable[[], Mode],
        send: Send,
        report: Report,
    ) -> None:
        self._store, self._loop, self._mode = store, loop, mode
        self._send, self._report = send, report
        self._values, damaged = stored_values(store)
        self._base = _configured(config)
        if damaged:
            report("PARAMETERS_CORRUPT", f"{damaged} stored generations cannot be read")

    def get(self, name: str) -> float:
        """Return the value in use."""
        return self._values.get(name, self._base[name])

    def handlers(self) -> dict[str, Handler]:
        """Return what takes this service's telecommands."""
        return {
            "REPORT_PARAMETERS": lambda request: partial(self._tell, request.parameters),
            "SET_PARAMETERS": self._set,
        }

    def _tell(self, parameters: tuple[tuple[Parameter, float], ...]) -> Done:
        for item, _ in parameters:
            self._send(f"parameter_{item.name}", {"n": 1, item.name: self.get(item.name)})
        return Done.NOW

    def _set(self, request: Request) -> Action:
        mode = self._mode()
        for place, (item, _) in enumerate(request.parameters, start=2):
            if item.modes and mode.name not in item.modes:
                raise TcError(Error.WRONG_MODE, place, mode, f"{item.name} in {mode.name}")
        wanted = {**self._values, **{item.name: value for item, value in request.parameters}}
        return partial(self._apply, request, wanted)

    def _apply(self, request: Request, wanted: dict[str, float]) -> Done:
        try:
            number = self._store.prepare(json.dumps(wanted, sort_keys=True).encode())
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
        return self._loop.order(request, [order], then, self._store.discard)

    def _commit(self, number: int, wanted: dict[str, float]) -> None:
        try:
            self._store.commit(number)
        except OSError as error:
            raise TcError(Error.FAILED, text=f"cannot be kept: {error.strerror}") from error
        self._values = wanted
        self._report("PARAMETERS_SET", ", ".join(f"{n} {v:.6g}" for n, v in wanted.items()))


def _configured(config: Config) -> dict[str, float]:
    values = {item.name: float(item.default) for item in DICTIONARY.parameters}
    section = config.estimator.model_dump()
    values |= {name: float(section[key] or 0.0) for name, key in ESTIMATOR.items()}
    return values
