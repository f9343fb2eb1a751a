"""Judge the clock of imported data: order of its stamps, and their rate by the declared one."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fsw.errors import ConfigError
from fsw.exchange.recording import END_NS
from fsw.messages import IntArray

DISORDER_NS = 1e7  # stamps may run back by less (two processors); a larger step is a clock set back
RATE_RATIO = 1.2  # accepted ratio of found to declared rate, or of declared to found
TINY_RATIO = 3.0  # a rate this much too high is of stamps that are differences, if ...
UNORDERED = 0.25  # ... more than this share of the steps does not go forward
LEAST_BYTES, MOST_BYTES = 8, 1000  # of a serial line for one sample; a datagram has 18 to 261
PAUSE_S, PAUSE_PERIODS = 1.0, 10.0  # a longer step is a pause, not part of the rate


def refuse_disorder(path: Path, t_ns: IntArray, most_ns: float = DISORDER_NS) -> None:
    """Refuse stamps that run backwards by more than `most_ns`, are negative or too large.

    Raises
    ------
    ConfigError that names the first such step, or the stamp out of range.
    """
    back = np.flatnonzero(np.diff(t_ns) < -most_ns)
    if back.size:
        first = int(back[0])
        before, after = t_ns[first] * 1e-9, t_ns[first + 1] * 1e-9
        raise ConfigError(
            f"{path}: time runs backwards {back.size} times, first at sample {first + 2}: "
            f"{after:.6f} s after {before:.6f} s; cut it there, or correct the clock"
        )
    if t_ns.min() < 0:
        raise ConfigError(f"{path}: a stamp at {t_ns.min() * 1e-9:g} s; must be at least 0")
    if t_ns.max() >= END_NS - 1:
        most_s = END_NS * 1e-9
        raise ConfigError(f"{path}: a stamp at {most_s:g} s or later; must be below {most_s:g}")


def refuse_differences(
    path: Path, events: str, t_ns: IntArray, rates_hz: Mapping[str, float], what: str = ""
) -> None:
    """Refuse stamps that are all one, or look like the times between the events.

    Parameters
    ----------
    t_ns : (k,) stamps of periodic events, in the order of the file
    events : name of the events
    rates_hz : declared rates by key of the configuration
    what : what the file holds, for the message; empty: the events

    Raises
    ------
    ConfigError that names the time between the stamps, and the time that the rate gives.
    """
    steps, count, span_s = np.diff(t_ns), len(t_ns), (int(t_ns.max()) - int(t_ns.min())) * 1e-9
    if count > 1 and not span_s and not what:
        raise ConfigError(f"{path}: {events}: all {count} stamps are {t_ns[0] * 1e-9:.10g} s")
    for key, declared_hz in rates_hz.items():
        is_tiny = span_s * declared_hz * TINY_RATIO < count - 1
        if is_tiny and (steps <= 0).mean() > UNORDERED:
            words = what or f"{count} {events}"
            raise ConfigError(
                f"{path}: {words} in {span_s:.3g} s, where {count} {events} at {key} "
                f"{declared_hz:g} take {(count - 1) / declared_hz:.3g} s: are the stamps "
                "differences?"
            )


def refuse_other_rate(
    path: Path, events: str, t_ns: IntArray, rates_hz: Mapping[str, float]
) -> None:
    """Refuse stamps of periodic events that contradict the declared rate.

    The mean over the time without pauses is compared, since loggers stamp in bursts. For the
    parameters see `refuse_differences`.

    Raises
    ------
    ConfigError that names both rates.
    """
    for key, declared_hz in rates_hz.items():
        steps_s = np.diff(t_ns) * 1e-9
        steps_s = steps_s[np.abs(steps_s) <= max(PAUSE_S, PAUSE_PERIODS / declared_hz)]
        count, took_s = len(steps_s), float(steps_s.sum())
        if not count or took_s <= 0.0:
            continue
        found_hz = count / took_s
        if not 1.0 / RATE_RATIO < found_hz / declared_hz < RATE_RATIO:
            raise ConfigError(
                f"{path}: {events} come at {found_hz:.4g} Hz; {key} is {declared_hz:g}: set it to "
                f"{found_hz:.3g}, or correct the stamps"
            )


def refuse_other_size(
    path: Path, t_ns: IntArray, sizes: IntArray, key: str, rate_hz: float
) -> None:
    """Refuse stamps of a serial line that leave impossibly few or many bytes for a sample.

    Parameters
    ----------
    t_ns, sizes : (k,) stamps [ns] and numbers of bytes, in the order of the file
    key, rate_hz : key of the declared rate, and the rate

    Raises
    ------
    ConfigError that names the number of bytes for a sample.
    """
    steps_s = np.diff(t_ns) * 1e-9
    is_regular = np.abs(steps_s) <= max(PAUSE_S, PAUSE_PERIODS / rate_hz)
    took_s, count = float(steps_s[is_regular].sum()), int(sizes[1:][is_regular].sum())
    samples = took_s * rate_hz
    if not is_regular.any() or LEAST_BYTES * samples <= count <= MOST_BYTES * samples:
        return
    guess = "differences" if count > MOST_BYTES * samples else "in another unit than seconds"
    per_sample = f"{count / samples:.3g} bytes" if samples > 0.0 else f"{count} bytes in no time"
    raise ConfigError(
        f"{path}: {per_sample} for a sample at {key} {rate_hz:g}; must be {LEAST_BYTES} to "
        f"{MOST_BYTES}: are the stamps {guess}?"
    )
