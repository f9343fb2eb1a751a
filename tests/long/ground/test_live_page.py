"""The live page in a browser, beside a running daemon in a real-time run of the bench."""

import subprocess
import sys
from collections.abc import Iterator

import pytest

from ground.assets import ENTRY, default_folder
from tests.support.browser import ARTIFACTS, chromium, console_errors, drawn, head, shown
from tests.support.live_run import ENVIRONMENT, LiveRun, wait_for

pytestmark = pytest.mark.timeout(900)  # a busy machine draws the page slowly


@pytest.fixture(scope="module")
def live(tmp_path_factory) -> Iterator[LiveRun]:
    run = LiveRun(tmp_path_factory.mktemp("live"))
    yield run
    run.close()


@pytest.fixture
def page(live, tmp_path) -> Iterator[object]:
    """Return a browser that shows the live page."""
    if not (default_folder() / ENTRY).exists():
        pytest.skip("needs Open MCT: ground fetch-assets, or sh tests/setup --all")
    command = [
        sys.executable,
        "-m",
        "ground",
        "--port",
        str(live.port),
        "serve",
        "--http-port",
        "0",
    ]
    gateway = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT)
    try:
        assert gateway.stdout is not None
        address = gateway.stdout.readline().strip()
        with chromium(tmp_path / "profile") as browser:
            browser.get(f"{address}explore")
            yield browser
    finally:
        gateway.terminate()
        gateway.communicate(timeout=30)


def test_the_live_page_sees_the_targets_mass_change(live, page):
    first = wait_for("a mass", lambda: shown(page, "target mass")[0])
    wait_for("another mass", lambda: shown(page, "target mass")[0] not in ("", first))
    assert drawn(page)
    assert live.daemon.poll() is None
    ARTIFACTS.mkdir(parents=True, exist_ok=True)
    assert page.save_screenshot(str(ARTIFACTS / "live_page.png"))
    assert console_errors(page) == []


def test_the_live_page_sees_staleness_when_the_daemon_is_stopped(live, page):
    wait_for("a mass", lambda: shown(page, "target mass")[0])
    live.stop_daemon()
    wait_for("STALE", lambda: "STALE" in head(page))
    wait_for("a stale row", lambda: shown(page, "target mass")[1])
    page.save_screenshot(str(ARTIFACTS / "stale_page.png"))
    assert console_errors(page) == []
