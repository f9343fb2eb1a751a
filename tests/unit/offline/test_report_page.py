"""The page of a report: self-contained, and safe whatever a recording says; its spectra."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from offline.report.page import page
from offline.report.spectrum import histogram, spectrum
from offline.report.view import MOST_POINTS, Chart, Line, Section, Table, View, line_of

HOSTILE = "</script><script>alert('@title@')</script> \" & \\1"


def hostile_view() -> View:
    line = Line(label=HOSTILE, y=[1.0, None, 3.0], low=[0.0, None, 2.0], high=[2.0, None, 4.0])
    chart = Chart(title=HOSTILE, x_label="time [s]", y_label=HOSTILE, x=[0, 1, 2], lines=[line])
    table = Table(head=(HOSTILE,), rows=[(HOSTILE,)])
    section = Section(title=HOSTILE, text=[HOSTILE], tables=[table], charts=[chart], source=HOSTILE)
    return View(title=HOSTILE, verdict=HOSTILE, valid=False, sections=[section, section])


class Scripts(HTMLParser):
    """Counts scripts, and collects what would be fetched."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0
        self.fetched: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.count += tag == "script"
        found = dict(attrs)
        self.fetched += [v for k in ("src", "href") if (v := found.get(k)) and v[0] != "#"]


def test_what_a_recording_says_is_text_and_nothing_is_fetched():
    text = page(hostile_view())
    scripts = Scripts()
    scripts.feed(text)
    assert scripts.count == 3
    assert scripts.fetched == ["data:,"]
    assert "url(" not in text
    assert "@import" not in text
    inside = re.search(r'type="application/json">(.*?)</script>', text, re.S)
    assert inside is not None
    charts = json.loads(inside[1])
    assert [chart["title"] for chart in charts] == [HOSTILE, HOSTILE]
    assert re.findall(r'data-chart="(\d)"', text) == ["0", "1"]


def test_a_long_line_is_thinned_and_what_is_not_finite_is_left_out():
    line = line_of("x", np.r_[np.nan, np.arange(10.0 * MOST_POINTS)])
    assert len(line.y) <= MOST_POINTS
    assert line.y[0] is None


def test_the_spectrum_of_white_noise_is_one_and_a_tone_stands_out():
    rng = np.random.default_rng(1)
    t_s = 0.05 * (np.arange(1200) + rng.uniform(-0.3, 0.3, 1200))  # uneven, as nodes are
    white = rng.standard_normal(len(t_s))
    frequency_hz, power = spectrum(t_s, white)
    assert power.mean() == pytest.approx(1.0, abs=0.15)
    frequency_hz, power = spectrum(t_s, white + 3.0 * np.sin(2 * np.pi * 4.0 * t_s))
    assert frequency_hz[np.argmax(power)] == pytest.approx(4.0, abs=0.2)
    assert power.max() > 10.0


def test_a_series_of_one_node_has_no_spectrum():
    frequency_hz, power = spectrum(np.array([1.0]), np.array([0.0]))
    assert len(frequency_hz) == len(power) == 0


def test_the_histogram_is_a_density_and_keeps_what_lies_outside():
    rng = np.random.default_rng(2)
    centre, density, normal = histogram(np.r_[rng.standard_normal(20_000), [50.0] * 5000])
    width = centre[1] - centre[0]
    assert density.sum() * width == pytest.approx(1.0)
    assert normal.sum() * width == pytest.approx(1.0, abs=1e-3)
    assert density[-1] * width == pytest.approx(0.2, abs=0.01)
