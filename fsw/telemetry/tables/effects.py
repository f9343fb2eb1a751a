"""Puts validated tables into use."""

import hashlib
from collections import deque
from collections.abc import Callable, Mapping

import yaml

from file_delivery.regular import read_regular
from fsw.config import Config
from fsw.config.tables import MonitorsTable, RatesTable
from fsw.messages.commands import CommandName, Reply
from fsw.telemetry.dictionary.codes import Error, Table
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Done
from fsw.telemetry.services.housekeeping import Housekeeping
from fsw.telemetry.services.monitors import Monitoring
from fsw.telemetry.tables.content import configured_noise, read_table, to_yaml, validate_table
from fsw.telemetry.tables.effective import laid_over

REMEMBERED = 8  # valid combinations of robot and table, not to be validated again


class TableEffects:
    """Applies tables: rates and monitors in the service, robot and noise in the loop."""

    def __init__(
        self, context: TelemetryContext, housekeeping: Housekeeping, monitoring: Monitoring
    ) -> None:
        self._context, self._base = context, context.config
        self._housekeeping, self._monitoring = housekeeping, monitoring
        self._default_rates = housekeeping.rates()
        self._sound: deque[bytes] = deque(maxlen=REMEMBERED)

    def validate(self, table: Table, content: bytes) -> None:
        """Raise ConfigError unless the table is valid together with the configuration file."""
        self._check(self._base, table, content, robot=b"")

    def _check(self, config: Config, table: Table, content: bytes, robot: bytes) -> None:
        """Validate a table with a robot (empty: the configured one), unless found valid before.

        A validation takes 0.1 s, and TBL_ACTIVATE would repeat that of TBL_VALIDATE.
        """
        below = robot or self._robot_file()
        parts = (table.name.encode(), below, content)
        key = hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).digest()
        if key not in self._sound:
            validate_table(config, table, content)
            self._sound.append(key)

    def _robot_file(self) -> bytes:
        try:
            return read_regular(self._base.resolve(self._base.robot.urdf))
        except OSError:
            return b""  # the validation reports it

    def recall(self, table: Table, content: bytes) -> None:
        """Use a stored rates or monitors table; the loop itself reads stored robots and noise."""
        if table is Table.RATES:
            self._rates(content)
        elif table is Table.MONITORS:
            self._monitors(content)

    def apply(
        self,
        table: Table,
        contents: Mapping[Table, bytes],
        request: Request,
        commit: Callable[[], None],
        failed: Callable[[], None],
    ) -> Done:
        """Put a table into use.

        Parameters
        ----------
        contents : contents of all tables, the new one included; an empty content: as configured
        commit : called when the table is in use
        failed : called when the loop rejects the table

        Raises
        ------
        ConfigError or TcError; then nothing has changed.
        """
        if table in (Table.RATES, Table.MONITORS):
            self.recall(table, contents[table])
            commit()
            return Done.NOW
        robot = contents[Table.ROBOT]
        try:
            config = self._base
            for other in (Table.ROBOT, Table.NOISE):
                below = robot if other is Table.NOISE else b""
                self._check(config, other, contents[other], below)
                config = laid_over(config, self._context.state, other, contents[other])
            text = read_regular(config.resolve(config.robot.urdf)).decode()
        except OSError as error:
            raise TcError(Error.FAILED, text=f"{error.filename}: {error.strerror}") from error

        def then(_reply: Reply) -> None:
            commit()
            self._context.latest.configure(config)
            self._context.host.configured(config)

        changes: dict[str, object] = {
            "noise": yaml.safe_load(configured_noise(config)),
            "urdf": str(config.resolve(config.robot.urdf)),
            "urdf_text": robot.decode() if robot else text,
        }
        return self._context.loop.order(request, [(CommandName.CONFIGURE, changes)], then, failed)

    def dump(self, table: Table) -> bytes:
        """Return the content in use of a table that was not uploaded. Raises TcError FAILED."""
        if table is Table.NOISE:
            return configured_noise(self._context.latest.config)
        if table is Table.RATES:
            return to_yaml({"sets": self._housekeeping.rates()})
        if table is Table.MONITORS:
            return to_yaml({"monitors": self._monitoring.table()})
        try:
            return read_regular(self._base.resolve(self._base.robot.urdf))
        except OSError as error:
            raise TcError(Error.FAILED, text=f"{error.filename}: {error.strerror}") from error

    def _rates(self, content: bytes) -> None:
        values = read_table(RatesTable, content) if content else None
        self._housekeeping.apply(values or RatesTable.model_validate({"sets": self._default_rates}))

    def _monitors(self, content: bytes) -> None:
        empty = MonitorsTable(monitors=())
        self._monitoring.apply(read_table(MonitorsTable, content) if content else empty)
