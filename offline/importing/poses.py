"""Static poses, one row each: every row becomes a standstill of one window.

A table of poses has no time. Each row is repeated at the rate of the bus for one window; then the
arm has as many windows as it needs at its speed limits to the next pose, without a sample.
"""

import numpy as np

from fsw.config import Config
from fsw.messages import FloatArray, IntArray
from offline.importing.tables import Parts


class Held(Parts):
    """A table whose rows are repeated."""

    def __init__(self, table: Parts, rows: IntArray) -> None:
        self.path, self.row, self._table, self._rows = table.path, table.row, table, rows

    def has(self, name: str) -> bool:
        """Return whether the table has a column."""
        return self._table.has(name)

    def notes(self, column: str) -> list[str]:
        """Return what the reader left out."""
        return self._table.notes(column)

    def refuse_other_unit(self, key: str, name: str, unit: str) -> None:
        """Raise ConfigError if a row of units contradicts a unit."""
        self._table.refuse_other_unit(key, name, unit)

    def column(self, name: str, unit: str = "") -> tuple[FloatArray, list[str]]:
        """Return a column (k, m) with a row for every sample, and notes."""
        values, notes = self._table.column(name, unit)
        return values[self._rows], notes


def standstills(config: Config, q_rad: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the row of every sample, and its stamp (k, 1) [s], for angles of poses (p, n)."""
    window_s = config.estimator.window_s
    samples = max(1, round(window_s * min(bus.rate_hz for bus in config.buses)))
    limit_rad_s = min(joint.speed_limit_rad_s for joint in config.joints)
    far_rad = np.nan_to_num(np.abs(np.diff(q_rad, axis=0)).max(axis=1))
    gaps = 1 + np.ceil(far_rad / (limit_rad_s * window_s))
    first = np.concatenate([[0.0], np.cumsum(1.0 + gaps)])
    stamps = (first[:, None] + np.arange(samples) / samples) * window_s
    return np.repeat(np.arange(len(q_rad)), samples), stamps.reshape(-1, 1)
