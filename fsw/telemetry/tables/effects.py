"""What the tables do when they are in force."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import yaml

from fsw.config import Config
from fsw.config.tables import MonitorsTable, RatesTable
from fsw.messages.commands import CommandName, Reply
from fsw.telemetry.dictionary.codes import Error, Table
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.executor import Done
from fsw.telemetry.services.housekeeping import Housekeeping
from fsw.telemetry.services.loop_commands import LoopCommands
from fsw.telemetry.services.monitors import Monitoring
from fsw.telemetry.tables.content import configured_noise, read_table, to_yaml, validate_table
from fsw.telemetry.tables.effective import laid_over


class TableEffects:
    """Applies contents: rates and monitors here, robot and noise in the loop.

    Parameters
    ----------
    base : the configuration as it was read, nothing laid over
    active : content in force of another table
    configured : told the configuration in force
    """

    def __init__(
        self,
        base: Config,
        state: Path,
        loop: LoopCommands,
        housekeeping: Housekeeping,
        monitoring: Monitoring,
        configured: Callable[[Config], None],
    ) -> None:
        self._base, self._state, self._loop = base, state, loop
        self._housekeeping, self._monitoring = housekeeping, monitoring
        self._configured = configured
        self._default_rates = housekeeping.rates()
        self.config = base  # in force
        self.active: Callable[[Table], bytes] = lambda _: b""

    def validate(self, table: Table, content: bytes) -> None:
        """Raise ConfigError unless the table fits the configuration as it was read."""
        validate_table(self._base, table, content)

    def recall(self, table: Table, content: bytes) -> None:
        """Put a stored table in force at the start; robot and noise the loop has by itself."""
        if table is Table.RATES:
            self._rates(content)
        elif table is Table.MONITORS:
            self._monitors(content)

    def apply(
        self,
        table: Table,
        content: bytes,
        request: Request,
        commit: Callable[[], None],
        failed: Callable[[], None],
    ) -> Done:
        """Put a table in force. Raises ConfigError or TcError; then nothing has changed."""
        if table in (Table.RATES, Table.MONITORS):
            self.recall(table, content)
            commit()
            return Done.NOW
        contents = {other: self.active(other) for other in (Table.ROBOT, Table.NOISE)}
        contents[table] = content
        robot = contents[Table.ROBOT]
        try:
            config = self._base
            for other in (Table.ROBOT, Table.NOISE):
                validate_table(config, other, contents[other])
                config = laid_over(config, self._state, other, contents[other])
            text = config.resolve(config.robot.urdf).read_text()
        except OSError as error:
            raise TcError(Error.FAILED, text=f"{error.filename}: {error.strerror}") from error

        def then(_reply: Reply) -> None:
            commit()
            self.in_force(config)

        changes: dict[str, object] = {
            "noise": yaml.safe_load(configured_noise(config)),
            "urdf": str(config.resolve(config.robot.urdf)),
            "urdf_text": robot.decode() if robot else text,
        }
        return self._loop.order(request, [(CommandName.CONFIGURE, changes)], then, failed)

    def in_force(self, config: Config) -> None:
        """Take the configuration that holds now."""
        self.config = config
        self._configured(config)

    def dump(self, table: Table) -> bytes:
        """Return what is in force where nothing was uplinked."""
        if table is Table.NOISE:
            return configured_noise(self.config)
        if table is Table.RATES:
            return to_yaml({"sets": self._housekeeping.rates()})
        if table is Table.MONITORS:
            return to_yaml({"monitors": self._monitoring.table()})
        try:
            return self._base.resolve(self._base.robot.urdf).read_bytes()
        except OSError as error:
            raise TcError(Error.FAILED, text=f"{error.filename}: {error.strerror}") from error

    def _rates(self, content: bytes) -> None:
        values = read_table(RatesTable, content) if content else None
        self._housekeeping.apply(values or RatesTable.model_validate({"sets": self._default_rates}))

    def _monitors(self, content: bytes) -> None:
        empty = MonitorsTable(monitors=())
        self._monitoring.apply(read_table(MonitorsTable, content) if content else empty)
