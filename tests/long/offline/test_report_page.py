"""The page of a report in Chromium: drawn, zoomable, no error, nothing wider than the window."""

import base64

import numpy as np
import pytest

from offline.report.page import page
from offline.report.view import TIME, Chart, Line, Section, Table, View, line_of
from tests.support.browser import ARTIFACTS, chromium, console_errors

OVERLAPS = """
const inside = (a, b) => a.right > b.left + 1 && b.right > a.left + 1
  && a.bottom > b.top + 1 && b.bottom > a.top + 1;
const boxes = [...document.querySelectorAll('h1, h2, p, #verdict, nav, .table, figure')]
  .map((part) => part.getBoundingClientRect());
let count = 0;
boxes.forEach((a, i) => boxes.slice(i + 1).forEach((b) => { count += inside(a, b); }));
return count;
"""
SHOWN = "return [document.documentElement.scrollWidth, document.body.dataset.drawn]"
RANGE = "const {min, max} = window.plots[0].scales.x; return [min, max];"


def example() -> View:
    """Return a page with one of every kind, with long words."""
    t_s = np.linspace(0.0, 60.0, 600)
    wave = np.sin(t_s)
    banded = line_of("torque of a joint with a long name", wave, wave - 1, wave + 1)
    common = {"x_label": TIME, "x": t_s.tolist()}
    events = [Line(label="event", y=[float(k % 4) for k in range(600)], points=True)]
    found = [Line(label="found", y=list(map(float, range(41)))), Line(label="normal", y=[1.0] * 41)]
    charts = [
        Chart(title="a" * 60, y_label="torque [N m]", lines=[banded], y_range=(-3.0, 3.0),
              **common),
        Chart(title="sigma", y_label="1 sigma [kg]", lines=[line_of("s", np.exp(-t_s))], log=True,
              **common),
        Chart(title="Events", y_label="severity", lines=events, y_range=(-0.5, 3.5),
              levels=("info", "low", "medium", "high"), **common),
        Chart(title="bars", x_label="residual / sigma [1]", y_label="density [1]", bars=True,
              x=np.linspace(-5, 5, 41).tolist(), lines=found),
    ]  # fmt: skip
    table = Table(head=("quantity", *"abcdefgh"), rows=[("inertia", *["0.123456 kg m2"] * 8)] * 60)
    sections = [Section(title=f"Section {k}", text=["words " * 40], tables=[table], charts=charts,
                        in_rows_of=3, source="key: value\n" * 20) for k in range(2)]  # fmt: skip
    return View(title="recording.mcap", verdict="NOT VALID: MODEL_MISMATCH", valid=False,
                sections=sections)  # fmt: skip


def zoomed(browser) -> tuple[float, float]:
    """Drag over the first chart from a quarter to a half; return the range it shows then [s]."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium: sh tests/setup")
    over = browser.find_element("css selector", ".u-over")
    quarter = over.size["width"] // 4
    chain = webdriver.ActionChains(browser).move_to_element_with_offset(over, -quarter, 0)
    chain.click_and_hold().move_by_offset(quarter, 0).release().perform()
    low, high = browser.execute_script(RANGE)
    return low, high


def test_the_page_is_drawn_without_error_fits_and_zooms(tmp_path):
    path = tmp_path / "page.html"
    path.write_text(page(example()), encoding="utf-8")
    with chromium(tmp_path / "profile") as browser:
        for width in (1400, 390):
            size = {"width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
            browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            browser.get(path.as_uri())
            wide, drawn = browser.execute_script(SHOWN)
            assert int(drawn) == 8
            assert wide <= width
            assert browser.execute_script(OVERLAPS) == 0
            assert browser.execute_script(RANGE) == [0, 60]
            assert zoomed(browser) == pytest.approx((15.0, 30.0), abs=2.0)
            shot = browser.execute_cdp_cmd("Page.captureScreenshot", {})
            ARTIFACTS.mkdir(parents=True, exist_ok=True)
            (ARTIFACTS / f"report_{width}.png").write_bytes(base64.b64decode(shot["data"]))
        assert console_errors(browser) == []
