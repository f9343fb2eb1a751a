"""Telecommands to the telemetry application itself: ping, version, counters, keys, health."""

from collections.abc import Mapping
from functools import partial

from fsw.errors import ConfigError
from fsw.telemetry.dictionary import dictionary_crc32
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.eventing import Eventing
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.services.ground_link import GroundLink
from fsw.telemetry.services.supervision import Supervision
from fsw.telemetry.state.version import version_values


class OwnCommands:
    """Handles the telecommands that belong to no other service."""

    def __init__(
        self,
        context: TelemetryContext,
        link: GroundLink,
        events: Eventing,
        supervision: Supervision,
    ) -> None:
        self._context, self._link = context, link
        self._events, self._supervision = events, supervision

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of these telecommands."""
        return {
            "PING": lambda _: partial(self._answer, "alive", {}),
            "REPORT_VERSION": lambda _: self._report_version,
            "COMMAND_LOG_DUMP": self._dump_commands,
            "RESET_COUNTERS": lambda _: self._reset_counters,
            "LOAD_KEYS": lambda _: self._keys(),
            "CLEAR_HEALTH": lambda request: partial(self._clear_health, request.whole("mask")),
        }

    def _dump_commands(self, request: Request) -> Action:
        packets = partial(self._context.log.packets, request.whole("entries"))
        return self._context.long_work.action(request, packets)

    def _answer(self, name: str, values: Mapping[str, object]) -> Done:
        self._context.down.send(name, values)
        return Done.NOW

    def _report_version(self) -> Done:
        values: dict[str, object] = {
            "config_crc32": self._context.config_crc32,
            "dictionary_crc32": dictionary_crc32(),
            "boot_count": self._context.boot.count,
        }
        return self._answer("version", values | version_values())

    def _reset_counters(self) -> Done:
        self._context.executor.reset_counters()
        self._events.reset_counters()
        self._link.reset_counters()
        return Done.NOW

    def _keys(self) -> Action:
        security = self._link.security
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
        self._supervision.health.clear(mask)
        return Done.NOW
