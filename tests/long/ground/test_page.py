"""The live page in Chromium on a stand-in for the daemon; the daemon itself: test_third_parties."""

import subprocess
import sys

import pytest

from ground.assets import ENTRY, default_folder
from tests.support.browser import ARTIFACTS, chromium, console_errors, drawn, head, shown
from tests.support.fake_daemon import FakeDaemon, run_of_estimates
from tests.support.live_run import ENVIRONMENT, wait_for


def test_the_page_follows_the_mass_and_shows_what_is_stale(tmp_path):
    if not (default_folder() / ENTRY).exists():
        pytest.skip("needs Open MCT: ground fetch-assets, or sh tests/setup --all")
    with FakeDaemon(stream=run_of_estimates(), period_s=0.4) as daemon:
        command = ["-m", "ground", "--port", str(daemon.port), "serve", "--http-port", "0"]
        gateway = subprocess.Popen(
            [sys.executable, *command], stdout=subprocess.PIPE, text=True, env=ENVIRONMENT
        )
        try:
            assert gateway.stdout is not None
            with chromium(tmp_path / "profile") as browser:
                browser.get(gateway.stdout.readline().strip() + "explore")
                first = wait_for("a mass", lambda: shown(browser, "target mass")[0])
                wait_for("another", lambda: shown(browser, "target mass")[0] not in ("", first))
                wait_for("LIVE", lambda: "LIVE" in head(browser))
                wait_for("fresh", lambda: not shown(browser, "target mass")[1])
                assert drawn(browser)
                daemon.pause.set()
                wait_for("STALE", lambda: "STALE: ESTIMATE, HEALTH" in head(browser))
                wait_for("stale", lambda: shown(browser, "target mass")[1])
                daemon.pause.clear()
                wait_for("LIVE", lambda: "LIVE" in head(browser))
                daemon.stop()
                wait_for("no link", lambda: "STALE" in head(browser))
                ARTIFACTS.mkdir(parents=True, exist_ok=True)
                browser.save_screenshot(str(ARTIFACTS / "page_stand_in.png"))
                assert console_errors(browser) == []
        finally:
            gateway.terminate()
            gateway.communicate(timeout=30)
