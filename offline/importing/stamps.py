"""Judge the stamps of sampled data: order, repetitions, gaps, jitter, rate."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsw.errors import ConfigError
from fsw.messages import FloatArray, IntArray
from offline.checks.recorded import rate_words
from offline.importing.clock import RATE_RATIO, refuse_differences, refuse_disorder

MOSTLY = 0.5  # share of steps backwards above which the file is refused
LEAST = 8  # least number of samples of a source
DISORDER_PERIODS = 2.0  # a sample may be late by this; a larger step back is a clock set back
GAP_PERIODS = 3.0
COURSES = 5.0  # a motion goes further in two steps than in one, and noise as far


def refuse_two_courses(
    path: Path, columns: Sequence[str], values: FloatArray, stamps_s: FloatArray
) -> None:
    """Refuse rows that alternate between two courses, as of two programs on one topic.

    Parameters
    ----------
    values, stamps_s : (k, width), (k, 1) in the order of the file; NaN: missing

    Raises
    ------
    ConfigError that names the column, and how far the courses are apart.
    """
    if len(stamps_s) != len(values):
        return  # the caller compares the lengths
    values = values[np.argsort(stamps_s[:, 0], kind="stable")]
    for column, own in zip(columns, values.T, strict=True):
        known = own[np.isfinite(own)]
        if len(known) < LEAST:
            continue
        steps = np.abs(np.diff(known))
        near = float(np.median(np.minimum(steps[1:], steps[:-1])))  # one step alone may be noise
        next_but_one = float(np.median(np.abs(known[2:] - known[:-2])))
        if near > COURSES * next_but_one:
            raise ConfigError(
                f"{path}: {column}: every second row follows another course, {near:.2g} away: do "
                "two programs publish these values? keep the rows of one (of noise at half the "
                "sample rate the mean of two rows)"
            )


def judged(
    path: Path,
    name: str,
    t_ns: IntArray,
    values: FloatArray,
    rates_hz: Mapping[str, float],
    *,
    may_repeat: bool = False,
) -> tuple[NDArray[np.intp], str]:
    """Return the indices of the rows to use, in order of time, and a text on what was found.

    A row that repeats all values of the row before is left out: the logger has held the last
    sample. A second row of one time is left out too. Rows that are a little late are sorted.

    Parameters
    ----------
    t_ns, values : (k,) stamps [ns], (k, width)
    rates_hz : declared rates by key of the configuration
    may_repeat : keep repeated rows, since coarse readings are often equal

    Raises
    ------
    ConfigError when time runs backwards, samples are too few, or their rate is not the declared.
    """
    same = np.nan_to_num(values[1:]) == np.nan_to_num(values[:-1])
    kept = np.flatnonzero(np.append(True, may_repeat | ~same.all(axis=1)))
    if len(kept) < LEAST:
        raise ConfigError(
            f"{path}: {name}: {len(kept)} different samples of {len(t_ns)}; must be at least "
            f"{LEAST}"
        )
    refuse_differences(path, name, t_ns[kept], rates_hz)
    period_ns = float(np.median(np.abs(np.diff(t_ns[kept]))))
    refuse_disorder(path, t_ns[kept], DISORDER_PERIODS * period_ns)
    held, disordered = len(t_ns) - len(kept), int((np.diff(t_ns[kept]) < 0).sum())
    if disordered > MOSTLY * len(kept):
        raise ConfigError(
            f"{path}: {name}: time runs backwards in {disordered} of {len(kept) - 1} steps; "
            "put the rows in order of time"
        )
    kept = kept[np.argsort(t_ns[kept], kind="stable")]
    is_new = np.append(True, np.diff(t_ns[kept]) > 0)
    kept, doubled = kept[is_new], int((~is_new).sum())
    steps_s = np.diff(t_ns[kept]) * 1e-9
    period_s = float(np.median(steps_s)) if len(steps_s) else 0.0
    gaps = steps_s[steps_s > GAP_PERIODS * period_s]
    regular = steps_s[steps_s <= GAP_PERIODS * period_s]
    if len(regular) < LEAST - 1:
        raise ConfigError(f"{path}: {name}: {len(kept)} times; must be at least {LEAST}")
    found_hz = 1.0 / float(regular.mean())
    for key, declared_hz in rates_hz.items():
        if not 1.0 / RATE_RATIO < found_hz / declared_hz < RATE_RATIO:
            advice = rate_words(key, declared_hz, found_hz) or f"set it to {found_hz:.3g}"
            raise ConfigError(
                f"{path}: {name} come at {found_hz:.4g} Hz; {key} is {declared_hz:g}: {advice}"
            )
    troubles = [
        f"{words}: {count}"
        for count, words in (
            (held, "repeat the row before, left out"),
            (doubled, "at the time of another row, left out"),
            (disordered, "out of order, sorted"),
        )
        if count
    ]
    if len(gaps):
        troubles.append(f"gaps: {len(gaps)}, the longest {gaps.max():.3g} s")
    lasted_s = (t_ns[kept[-1]] - t_ns[kept[0]]) * 1e-9
    words = f"{len(kept)} samples in {lasted_s:.1f} s, {found_hz:.4g} Hz"
    jitter = f"{words}, jitter {1e3 * round(float(regular.std()), 9):.2g} ms rms"
    return kept, "; ".join([jitter, *troubles])
