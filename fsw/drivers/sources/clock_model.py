"""Model of a device's clock against the host's: the straight line under all arrivals.

The host sees an item with device time n when it was sent plus a delay that is never negative. So
the line t = offset + tick n lies under every observation, and the earliest observations define it.
The minima of short bins over the last minute are kept. The line is the edge of their lower convex
hull at mid-span: for evenly spaced minima, the line below them with the least summed distance.
"""

import itertools
import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from fsw.messages import FloatArray, IntArray

BIN_S = 0.25
SPAN_S = 60.0
MIN_RATE_SPAN_S = 0.5  # below it only the offset is fitted
CONTRADICTION_NS = 10e6  # if all arrivals are later than the model by this ...
CONTRADICTION_BINS = 4  # ... in this many bins in a row, the device's time has jumped

_Point = tuple[float, float]  # device time since the first observation [s], residual [ns]


class ClockModel:
    """Offset and rate of a device's clock, from observations that are never early.

    Parameters
    ----------
    tick_s : nominal length of one device tick [s]
    tolerance_ppm : bound of the rate error [ppm]
    """

    def __init__(self, tick_s: float, tolerance_ppm: float) -> None:
        self._tick_s = tick_s
        self._max_slope = tolerance_ppm * 1e3  # [ns/s]
        self.reset()

    def reset(self) -> None:
        """Discard every observation."""
        self._n0 = 0
        self._t0_ns = 0
        self._empty = True
        self._offset_ns = 0.0
        self._slope = 0.0  # rate error [ns/s]
        self._points: deque[_Point] = deque()
        self._hull: list[_Point] = []
        self._bin = 0
        self._lowest: _Point = (0.0, math.inf)
        self._late_bins = 0

    @property
    def ready(self) -> bool:
        """Return whether there is any observation."""
        return not self._empty

    @property
    def rate_error_ppm(self) -> float:
        """Rate error of the device: positive when its ticks are longer than nominal."""
        return self._slope * 1e-3

    def observe(self, n: int, t_ns: int, rest_ns: float) -> None:
        """Record that the item of device time n [ticks] arrived by host time t_ns + rest_ns."""
        if self._empty:
            self._empty = False
            self._n0, self._t0_ns, self._offset_ns = n, t_ns, rest_ns
            self._lowest = (0.0, rest_ns)
            return
        x = (n - self._n0) * self._tick_s
        residual = (t_ns - self._t0_ns) + (rest_ns - x * 1e9)
        index = int(x / BIN_S)
        if index != self._bin:
            self._close_bin()
            self._bin = index
            self._lowest = (x, residual)
        elif residual < self._lowest[1]:
            self._lowest = (x, residual)
        self._offset_ns = min(self._offset_ns, residual - self._slope * x)

    def follow(
        self, n: IntArray, t_ns: IntArray, rest_ns: FloatArray, known: IntArray
    ) -> FloatArray:
        """Observe the arrivals of the first k of m items; return the host times of all m.

        The result is that of `observe` and `predict_ns` called item by item.

        Parameters
        ----------
        n : (m,) device times [ticks]
        t_ns, rest_ns : (k,) item i arrived by host time t_ns[i] + rest_ns[i] [ns]
        known : (m,) number of observations that are made before each host time is computed

        Returns
        -------
        (m,) host times minus `reference_ns` [ns]
        """
        count = len(t_ns)
        x = (n - self._n0) * self._tick_s
        residual = (t_ns - self._t0_ns) + (rest_ns - x[:count] * 1e9)
        bins = (x[:count] / BIN_S).astype(np.int64)
        offset, slope = np.empty(count + 1), np.empty(count + 1)
        offset[0], slope[0] = self._offset_ns, self._slope
        starts = np.flatnonzero(bins[1:] != bins[:-1]) + 1
        bounds = [0, *starts.tolist(), count] if count else []
        for start, stop in itertools.pairwise(bounds):
            part, at = slice(start, stop), start + int(residual[start:stop].argmin())
            lowest = (float(x[at]), float(residual[at]))
            if bins[start] != self._bin:
                self._close_bin()
                self._bin, self._lowest = int(bins[start]), lowest
            elif lowest[1] < self._lowest[1]:
                self._lowest = lowest
            slope[start + 1 : stop + 1] = self._slope
            least = np.minimum.accumulate(residual[part] - self._slope * x[part])
            offset[start + 1 : stop + 1] = np.minimum(least, self._offset_ns)
            self._offset_ns = float(offset[stop])
        return np.asarray(x * 1e9 + offset[known] + slope[known] * x)

    def follow_near(
        self, n: int, t_ns: Sequence[int], rest_ns: float, early_ns: float, late_ns: float
    ) -> list[float]:
        """Record items of device times n, n + 1 ... while each arrives near the line.

        The result is that of `observe` and `predict_ns` called item by item.

        Parameters
        ----------
        t_ns, rest_ns : item k arrived by t_ns[k] + rest_ns
        early_ns, late_ns : bounds of an arrival before and after the line

        Returns
        -------
        host times minus `reference_ns` [ns] of the recorded items, up to the first that is not near
        """
        found: list[float] = []
        t0_ns, tick_s, offset, slope = self._t0_ns, self._tick_s, self._offset_ns, self._slope
        lowest, edge = self._lowest[1], (self._bin + 1) * BIN_S
        steps = n - self._n0
        for stamp_ns in t_ns:
            x = steps * tick_s
            x_ns = x * 1e9
            residual = (stamp_ns - t0_ns) + (rest_ns - x_ns)
            least = residual - slope * x
            if not -early_ns < least - offset < late_ns:
                break
            if x >= edge:
                self._close_bin()
                offset, slope, self._bin = self._offset_ns, self._slope, int(x / BIN_S)
                edge, lowest = (self._bin + 1) * BIN_S, math.inf
                least = residual - slope * x
            if residual < lowest:
                lowest, self._lowest = residual, (x, residual)
            if least < offset:
                self._offset_ns = offset = least
            found.append(x_ns + offset + slope * x)
            steps += 1
        return found

    @property
    def reference_ns(self) -> int:
        """Host time that must be added to the times that `follow` returns [ns]."""
        return self._t0_ns

    def predict_ns(self, n: int) -> tuple[int, float]:
        """Return the host time of device time n as the sum of an integer and a rest [ns]."""
        x = (n - self._n0) * self._tick_s
        return self._t0_ns, x * 1e9 + self._offset_ns + self._slope * x

    def early_ns(self, n: int, t_ns: float) -> float:
        """Return how much earlier than the model an observation is (negative: later) [ns]."""
        reference, rest = self.predict_ns(n)
        return rest - (t_ns - reference)

    def device_time(self, t_ns: float) -> float:
        """Return the device time [ticks] that the model gives for host time t_ns."""
        seconds = (t_ns - self._t0_ns - self._offset_ns) / (1e9 + self._slope)
        return self._n0 + seconds / self._tick_s

    def _close_bin(self) -> None:
        x, residual = self._lowest
        late = residual - (self._offset_ns + self._slope * x)
        self._late_bins = self._late_bins + 1 if late > CONTRADICTION_NS else 0
        self._points.append(self._lowest)
        expired = False
        while self._points[0][0] < x - SPAN_S:
            expired |= self._points.popleft() == self._hull[0]
        if self._late_bins >= CONTRADICTION_BINS:
            while len(self._points) > CONTRADICTION_BINS:
                self._points.popleft()
            self._late_bins = 0
            expired = True
        if expired:
            self._hull = []
            for point in self._points:
                _append(self._hull, point)
        else:
            _append(self._hull, self._lowest)
        self._fit()

    def _fit(self) -> None:
        first, last = self._points[0][0], self._points[-1][0]
        slope = 0.0
        if last - first >= MIN_RATE_SPAN_S and len(self._hull) > 1:
            middle = 0.5 * (first + last)
            at = 1
            while at < len(self._hull) - 1 and self._hull[at][0] < middle:
                at += 1
            (x0, r0), (x1, r1) = self._hull[at - 1], self._hull[at]
            slope = min(max((r1 - r0) / (x1 - x0), -self._max_slope), self._max_slope)
        self._slope = slope
        self._offset_ns = min(r - slope * x for x, r in self._hull)


def _append(hull: list[_Point], point: _Point) -> None:
    """Extend a lower convex hull by a point to its right."""
    x, r = point
    while hull and hull[-1][0] >= x:
        if hull[-1][1] <= r:
            return
        hull.pop()
    while len(hull) > 1:
        (x0, r0), (x1, r1) = hull[-2], hull[-1]
        if (r1 - r0) * (x - x0) < (r - r0) * (x1 - x0):
            break
        hull.pop()
    hull.append(point)
