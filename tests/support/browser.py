"""Chromium without a window, for the live page."""

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
PATIENCE_S = 180.0  # with a busy machine, on which everything is drawn by the processor
ARTIFACTS = Path(__file__).parents[2] / "build" / "artifacts"


@contextmanager
def chromium(folder: Path) -> Iterator[Any]:
    """Give a browser for a block; its profile is new and in `folder`."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium: sh tests/setup")
    found = shutil.which("chromium"), shutil.which("chromedriver")
    if None in found:
        pytest.skip("needs Debian's chromium and chromium-driver: sh tests/setup --all")
    options = webdriver.ChromeOptions()
    options.binary_location = str(_ending_with_driver(folder, str(found[0])))
    for flag in (*FLAGS, f"--user-data-dir={folder}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = webdriver.chrome.service.Service(found[1])
    browser = webdriver.Chrome(options=options, service=service)
    browser.set_script_timeout(PATIENCE_S)
    browser.set_page_load_timeout(PATIENCE_S)
    try:
        yield browser
    finally:
        browser.quit()


def _ending_with_driver(folder: Path, program: str) -> Path:
    """Return a program that starts the browser, which then ends when its driver does."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "browser"
    path.write_text(f'#!/bin/sh\nexec setpriv --pdeathsig KILL -- {program} "$@"\n')
    path.chmod(0o700)
    return path


def console_errors(browser: Any) -> list[str]:
    """Return what the console says of errors since the last call."""
    return [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


_ROW = """
const rows = [...document.querySelectorAll('.c-lad-table tbody tr')];
const row = rows.find((row) => row.cells[0] && row.cells[0].innerText.trim() === arguments[0]);
return row ? [row.querySelector('[aria-label="lad value"]').innerText,
              row.querySelector('.is-stale') !== null] : ['', false];
"""


def shown(browser: Any, name: str) -> tuple[str, bool]:
    """Return what the latest-value table shows for a name, and whether as stale."""
    text, is_stale = browser.execute_script(_ROW, name)
    return str(text).strip(), bool(is_stale)


def head(browser: Any) -> str:
    """Return the text of the page's head, where the state of the link stands."""
    return str(
        browser.execute_script("return document.querySelector('.l-shell__head')?.innerText ?? ''")
    ).upper()


def drawn(browser: Any) -> bool:
    """Whether there is a plot."""
    return bool(browser.execute_script("return !!document.querySelector('.gl-plot canvas')"))
