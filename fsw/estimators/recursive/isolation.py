"""Which sensor does not fit the model: every channel's innovation judged on its own.

A sensor's error shows in its own channel only, because no other channel's prediction uses this
sensor. A change of the bodies, or of the arm's motion as measured, shows in many channels. So a
single channel that noise and the estimate's covariance do not explain is left out until it has
fitted again for some blocks. Several that newly fail in one block are left to change detection.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from fsw.estimators.measurement.mrnea import Rows
from fsw.messages import Block, FloatArray
from fsw.messages.findings import Fault, Finding

GOOD_BLOCKS = 2  # that fit in a row and end an isolation


class ChannelScreen:
    """Isolation of torque sensors, accelerometer and gyro by their innovations.

    Parameters
    ----------
    sensors : name of the sensor of each torque: a joint's, or one of several axes
    false_alarm : probability that one good channel of one block fails
    """

    def __init__(self, sensors: Sequence[str], false_alarm: float) -> None:
        self._sensors = tuple(dict.fromkeys(sensors))
        self._of = np.array([self._sensors.index(name) for name in sensors], np.intp)
        self._false_alarm = false_alarm
        self._out: dict[int, int] = {}  # channel: number of good blocks in a row
        self._found: list[Finding] = []

    def take(self) -> list[Finding]:
        """Return and discard the findings."""
        found, self._found = self._found, []
        return found

    def judge(
        self, block: Block, rows: Rows, step: FloatArray, covariance_root: FloatArray, level: float
    ) -> Block:
        """Return the block without its isolated channels; the same object if there are none.

        Parameters
        ----------
        rows : rows of the block, with the root of their noise covariance
        step : (p,) estimate minus the rows' linearisation point
        covariance_root : (p, p) root of the estimate's covariance
        level : ratio of the noise's variance to the declared one
        """
        ratios = self.ratios(rows, len(block.t_ns), step, covariance_root, level)
        if not ratios:
            return block
        failing = [c for c, ratio in ratios.items() if ratio > 1.0]
        newly = [c for c in failing if c not in self._out]
        if len(newly) == 1:
            self._out[newly[0]] = 0
        for channel in list(self._out):
            if channel in failing:
                self._out[channel] = 0
                self._tell(channel, int(block.t_ns[-1]), ratios[channel])
            elif channel in ratios:
                self._out[channel] += 1
                if self._out[channel] >= GOOD_BLOCKS:
                    del self._out[channel]
        return self._without(block) if self._out else block

    def ratios(
        self, rows: Rows, nodes: int, step: FloatArray, root: FloatArray, level: float
    ) -> dict[int, float]:
        """Return each used channel's normalised innovation squared over its limit.

        The parameters are those of `judge`. Rows without `root` or `use` give no ratio.
        """
        rows = rows.at_nodes
        if rows.root is None or rows.use is None:
            return {}
        n, L, use = len(self._sensors), rows.root, rows.use
        r = L @ (rows.b - rows.A @ step)
        V = np.concatenate([np.sqrt(level) * L, L @ (rows.A @ root)], axis=1)
        group = np.concatenate([self._of, np.repeat([n, n + 1], 3)])  # accelerometer, gyro last
        rows_of = np.tile(group[use], nodes)
        channels, sizes = np.unique(rows_of, return_counts=True)
        ends, order = np.cumsum(sizes), np.argsort(rows_of, kind="stable")
        ratios: dict[int, float] = {}
        for dof in np.unique(sizes).tolist():  # channels with equal numbers of rows together
            alike = np.flatnonzero(sizes == dof)
            own = order[(ends[alike] - dof)[:, None] + np.arange(dof)]
            S, part = V[own] @ V[own].transpose(0, 2, 1), r[own][:, :, None]
            nis = np.sum(part * np.linalg.solve(S, part), axis=(1, 2)) / chdtri(
                dof, self._false_alarm
            )
            ratios |= dict(zip(channels[alike].tolist(), nis.tolist(), strict=True))
        return ratios

    def _without(self, block: Block) -> Block:
        n = len(self._sensors)
        has_joint = block.has_joint & ~np.isin(self._of, list(self._out))
        return replace(
            block,
            has_joint=has_joint,
            has_accelerometer=block.has_accelerometer and n not in self._out,
            has_gyro=block.has_gyro and n + 1 not in self._out,
        )

    def _tell(self, channel: int, t_ns: int, ratio: float) -> None:
        n = len(self._sensors)
        subject, fault = "accelerometer", Fault.ACC_INCONSISTENT
        if channel < n:
            subject, fault = self._sensors[channel], Fault.TORQUE_INCONSISTENT
        elif channel > n:
            subject, fault = "gyro", Fault.GYRO_INCONSISTENT
        text = f"innovation squared {ratio:.2g} times its limit"
        self._found.append(Finding(t_ns, fault, subject, text))
