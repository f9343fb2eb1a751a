"""Chromium without a window, for the live page."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--window-size=1600,1000",
)
ARTIFACTS = Path(__file__).parents[2] / "build" / "artifacts"


@contextmanager
def chromium(folder: Path) -> Iterator[Any]:
    """Give a browser for a block; its profile is new and in `folder`."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium: sh tests/setup")
    found = shutil.which("chromium"), shutil.which("chromedriver")
    if None in found:
        pytest.skip("needs Debian's chromium and chromium-driver: sh tests/setup")
    options = webdriver.ChromeOptions()
    options.binary_location = found[0]
    for flag in (*FLAGS, f"--user-data-dir={folder}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = webdriver.chrome.service.Service(found[1])
    browser = webdriver.Chrome(options=options, service=service)
    try:
        yield browser
    finally:
        browser.quit()


def console_errors(browser: Any) -> list[str]:
    """Return what the console says of errors since the last call."""
    return [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


def table_row(browser: Any, name: str) -> Any | None:
    """Return the row of a latest-value table."""
    for row in browser.find_elements("css selector", ".c-lad-table tr.js-lad-table__body__row"):
        cells = row.find_elements("css selector", "td")
        if cells and cells[0].text == name:
            return row
    return None


def shown_value(browser: Any, name: str) -> str:
    """Return what the latest-value table shows for a name; empty while it shows nothing."""
    from selenium.common.exceptions import StaleElementReferenceException

    try:
        row = table_row(browser, name)
        cells = [] if row is None else row.find_elements("css selector", "td")
        return cells[2].text if len(cells) > 2 else ""
    except StaleElementReferenceException:  # it was drawn anew in between
        return ""
