"""Spectrum and histogram of normalised residuals."""

import numpy as np

from fsw.messages import FloatArray

FREQUENCIES = 128  # most frequencies that a spectrum has
FINER = 8  # neighbouring frequencies averaged into one
MOST = 20_000  # most nodes used; later ones are left out
BINS = 41
REACH = 5.0  # half-width of the histogram in sigmas; larger values count in the outermost bin


def spectrum(t_s: FloatArray, ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return frequencies [Hz] and power of unevenly spaced residuals; unit white noise has power 1.

    This is the Lomb-Scargle periodogram up to the mean Nyquist frequency, averaged over neighbours.
    """
    from scipy.signal import lombscargle  # takes 0.3 s, which only a report needs

    t_s, ratio = t_s[:MOST], ratio[:MOST]
    length_s = float(np.ptp(t_s))
    if len(t_s) < 2 or length_s <= 0:
        return np.empty(0), np.empty(0)
    count = min(FREQUENCIES, max(1, len(t_s) // (2 * FINER)))
    highest_hz = 0.5 * (len(t_s) - 1) / length_s
    fine_hz = highest_hz * np.arange(1, count * FINER + 1) / (count * FINER)
    groups_hz = fine_hz.reshape(count, FINER)
    since_s = t_s - t_s[0]
    # group by group: SciPy holds several numbers for each node and frequency
    power = [lombscargle(since_s, ratio, 2 * np.pi * own_hz).mean() for own_hz in groups_hz]
    return groups_hz.mean(axis=1), np.array(power, np.float64)


def histogram(ratio: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return bin centres, density of `ratio` and normal density, each (BINS,), over +-5 sigma."""
    edges = np.linspace(-REACH, REACH, BINS + 1)
    centre = 0.5 * (edges[1:] + edges[:-1])
    inside = np.clip(ratio, centre[0], centre[-1])
    density, _ = np.histogram(inside, edges, density=True)
    normal = np.exp(-0.5 * centre**2) / np.sqrt(2 * np.pi)
    return centre, np.asarray(density, np.float64), normal
