"""Telecommands that are the application's own: ping, version, counters, health."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from fsw.messages.errors import ConfigError
from fsw.telemetry.dictionary import dictionary_crc32
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.server import LinkCounters
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.state.version import version_values

if TYPE_CHECKING:
    from fsw.telemetry.application import TelemetryApplication


class OwnCommands:
    """Handlers of what needs the whole application."""

    def __init__(self, application: TelemetryApplication) -> None:
        self._app = application

    def handlers(self) -> dict[str, Handler]:
        """Return what takes these telecommands."""
        return {
            "PING": lambda _: partial(self._answer, "alive", {}),
            "REPORT_VERSION": lambda _: self._tell_version,
            "COMMAND_LOG_DUMP": self._dump_commands,
            "RESET_COUNTERS": lambda _: self._reset_counters,
            "LOAD_KEYS": lambda _: self._keys(),
            "CLEAR_HEALTH": lambda request: partial(self._clear_health, request.whole("mask")),
        }

    def _dump_commands(self, request: Request) -> Action:
        packets = partial(self._app.commands.packets, request.whole("entries"))
        return self._app.dumps.action(request, packets)

    def _answer(self, name: str, values: Mapping[str, object]) -> Done:
        self._app.down.send(name, values)
        return Done.NOW

    def _tell_version(self) -> Done:
        values: dict[str, object] = {
            "config_crc32": self._app.config_crc32,
            "dictionary_crc32": dictionary_crc32(),
            "boot_count": self._app.boot.count,
        }
        return self._answer("version", values | version_values())

    def _reset_counters(self) -> Done:
        self._app.dispatcher.reset_counters()
        self._app.events.reset_counters()
        if self._app.link is not None:
            self._app.link.counters = LinkCounters()
        return Done.NOW

    def _keys(self) -> Action:
        security = self._app.security
        if security is None:
            raise TcError(Error.NOT_SUPPORTED, text="the link has no keys")

        def act() -> Done:
            try:
                security.load_keys()
            except ConfigError as error:
                raise TcError(Error.FAILED, text=str(error)) from error
            return Done.NOW

        return act

    def _clear_health(self, mask: int) -> Done:
        self._app.supervision.health.clear(mask)
        return Done.NOW
