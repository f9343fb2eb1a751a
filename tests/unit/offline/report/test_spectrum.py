"""The spectrum of residuals: white noise is one, a line is where it is, and memory has a bound."""

import tracemalloc

import numpy as np

from offline.report.spectrum import MOST, spectrum

BOUND = 1000.0  # bytes of memory a node; all frequencies at once take over 20 000


def test_white_noise_has_power_one_and_a_line_stands_out_in_little_memory() -> None:
    rng = np.random.default_rng(2)
    t_s = 0.05 * np.arange(MOST)
    ratio = rng.standard_normal(MOST) + np.sin(2 * np.pi * 3.0 * t_s)
    spectrum(t_s[:64], ratio[:64])  # imports
    tracemalloc.start()
    try:
        frequency_hz, power = spectrum(t_s, ratio)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < BOUND * MOST
    line = int(np.argmax(power))
    assert abs(frequency_hz[line] - 3.0) < 0.1
    others = np.delete(power, [line - 1, line, line + 1])
    assert abs(others.mean() - 1.0) < 0.15
