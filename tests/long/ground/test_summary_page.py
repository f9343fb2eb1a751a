"""The overview of the live page in Chromium: what an operator sees, at two sizes, and commands."""

import getpass
import json
import re
import subprocess
import sys
import time

import pytest

from ground.assets import ENTRY, default_folder
from tests.support.browser import ARTIFACTS, chromium, console_errors
from tests.support.fake_daemon import FakeDaemon, completed, packet, report, run_of_estimates
from tests.support.live_run import ENVIRONMENT, wait_for

PORT_LOST = 10
SLIPS, PORT, BUS = 0, 1, 18  # bits of the health word, docs/telemetry.md
LATER = 40  # events: well behind the history


def telemetry(faults):
    """A run with faults: events in bursts, a latched bit, a slip, no base among the unknowns."""
    estimates = run_of_estimates(faults=faults)
    count = 0

    def make() -> bytes:
        nonlocal count
        count += 1
        met_s = time.monotonic()  # of all packets: they set the page's clock
        found = estimates() + packet("recorder", met_s=met_s, recording=1, disk_free_bytes=10**10)
        found += packet("link", met_s=met_s)
        found += packet("event_low", met_s=met_s, event=60, text=f"no {count}")
        if count == 3:
            found += packet("event_high", met_s=met_s, event=PORT_LOST, text="imu: <b>gone</b>")
        return found

    return make


SLOW_HISTORY = """
const before = window.fetch;
window.fetch = async (...asked) => {
  const answer = await before(...asked);
  const late = String(asked[0]).startsWith('history/estimate') ? 6000 : 0;
  await new Promise((end) => setTimeout(end, late));
  return answer;
};
"""


def answer(telecommand: bytes):
    if telecommand[7] == 17:
        accepted, started, done = completed(telecommand)
        return [accepted, started, packet("alive"), done]
    return [report("acceptance_failure", telecommand, error=8)]


def text(browser, selector: str) -> str:
    found = "return document.querySelector(arguments[0])?.innerText ?? ''"
    return str(browser.execute_script(found, selector))


def click(browser, selector: str) -> None:
    browser.execute_script("document.querySelector(arguments[0]).click()", selector)


def choose(browser, name: str) -> None:
    browser.execute_script(
        "const c = document.querySelector('#command'); c.value = arguments[0]; c.onchange()", name
    )


@pytest.fixture
def faults():
    """Return the words of the health packet; a test may change them."""
    return {"health": 0, "health_now": 0}


@pytest.fixture
def page(tmp_path, faults):
    """Give daemon, browser on the page, and the ground's state folder."""
    if not (default_folder() / ENTRY).exists():
        pytest.skip("needs Open MCT: ground fetch-assets, or sh tests/setup --all")
    with FakeDaemon(answer, stream=telemetry(faults), period_s=0.4) as daemon:
        command = ["-m", "ground", "--port", str(daemon.port), "--state", str(tmp_path / "state")]
        command += ["serve", "--http-port", "0", "--command"]
        gateway = subprocess.Popen(
            [sys.executable, *command], stdout=subprocess.PIPE, text=True, env=ENVIRONMENT
        )
        try:
            assert gateway.stdout is not None
            with chromium(tmp_path / "profile") as browser:
                browser.get(gateway.stdout.readline().strip())
                yield daemon, browser, tmp_path / "state"
        finally:
            gateway.terminate()
            gateway.communicate(timeout=30)


def test_an_operator_sees_the_verdict_the_values_and_commands(page):
    daemon, browser, state = page
    wait_for("a verdict", lambda: text(browser, "#verdict strong") == "VALID")
    wait_for("a mass", lambda: "kg" in text(browser, ".tile"))
    tiles = text(browser, "#tiles")
    assert "±" in text(browser, ".tile")
    assert "not identified" in tiles, "the base is known: it is not 0 kg"
    assert "0.0 ± 0.0 kg" not in tiles
    assert "Slips" in tiles
    assert "Recording\nyes" in tiles
    wait_for("a burst", lambda: "TC_REJECTED × " in text(browser, "#events"))  # noqa: RUF001
    wait_for("the loss", lambda: "PORT_LOST" in text(browser, "#events"))
    lines = text(browser, "#events").splitlines()
    assert sum("TC_REJECTED" in line for line in lines) == 1, "one line per burst"
    assert any("PORT_LOST" in line and "<b>gone</b>" in line for line in lines), "as text"
    script = "return document.querySelector('.event.high b')?.innerText"
    assert browser.execute_script(script) == "PORT_LOST"

    choose(browser, "PING")
    click(browser, "#prepare")
    assert b"\x11\x01" not in daemon.received[7:9], "nothing is sent before the confirmation"
    assert "Send PING?" in text(browser, "#buttons")
    click(browser, "#confirm")
    wait_for("its end", lambda: "PING: completed" in text(browser, "#outcome"))
    assert "completion success" in text(browser, "#outcome")
    choose(browser, "STOP_IDENTIFICATION")
    click(browser, "#prepare")
    click(browser, "#cancel")
    assert "Prepare" in text(browser, "#buttons")
    click(browser, "#prepare")
    click(browser, "#confirm")
    wait_for("refused", lambda: "WRONG_MODE" in text(browser, "#outcome"))
    told = [json.loads(line) for line in (state / "commands.jsonl").read_text().splitlines()]
    assert [(t["command"], t["outcome"], t["error"]) for t in told] == [
        ("PING", "completed", ""),
        ("STOP_IDENTIFICATION", "rejected", "WRONG_MODE"),
    ]
    assert {t["via"] for t in told} == {f"page, 127.0.0.1 ({getpass.getuser()})"}

    ARTIFACTS.mkdir(parents=True, exist_ok=True)
    for width, height in ((1400, 1000), (390, 844)):
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 700}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        wait_for("the size", lambda w=width: browser.execute_script("return innerWidth") == w)
        wide = browser.execute_script("return document.documentElement.scrollWidth")
        assert wide <= width, "nothing sticks out"
        name = "document.getElementById('tiles').children[5].getBoundingClientRect().bottom"
        assert browser.execute_script(f"return {name}") < height, "recording is above the fold"
        browser.save_screenshot(str(ARTIFACTS / f"page_{width}.png"))
        browser.execute_script("window.scrollTo(0, 900)")
        browser.save_screenshot(str(ARTIFACTS / f"page_{width}_below.png"))
        browser.execute_script("window.scrollTo(0, 0)")

    daemon.pause.set()
    wait_for("stale", lambda: "STALE" in text(browser, "#verdict"))
    daemon.stop()
    wait_for("no link", lambda: "NO TELEMETRY" in text(browser, "#verdict"))
    assert console_errors(browser) == []


PLOT = """
const rows = [[0, 300, 200, 400], [500, 350, 300, 400], [1000, 390, 380, 400],
              [20000, 399, 398, 400], [20500, 399.5, 399, 400], [21000, 399.6, 399.2, 400]];
return { parts: Plot.parts(rows).map((part) => part.length), range: Plot.range(rows) };
"""


def test_gaps_stay_gaps_and_the_band_is_visible_after_convergence(page):
    _, browser, _ = page
    wait_for("a verdict", lambda: text(browser, "#verdict"))
    found = browser.execute_script(PLOT)
    assert found["parts"] == [3, 3]
    low, high = found["range"]
    assert 397.0 < low < 398.0, "the scale is that of the band as it is now"
    assert 400.0 < high < 401.0


def test_events_that_come_while_the_history_is_fetched_are_shown_once(page):
    _, browser, _ = page
    browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": SLOW_HISTORY})
    browser.refresh()
    number, count = wait_for("a burst", lambda: burst(browser))
    while number < LATER:
        assert count == number, "of all events sent so far none is missing or doubled"
        number, count = wait_for("the next", lambda: burst(browser))
    assert count == number


def burst(browser) -> tuple[int, int] | None:
    """Return the number of the newest rejection that the page shows, and how many it counts."""
    found = re.search(r"TC_REJECTED × (\d+)\s.*no (\d+)", text(browser, "#events"))  # noqa: RUF001
    return (int(found[2]), int(found[1])) if found else None


@pytest.mark.parametrize(
    ("bit", "colour", "verdict"),
    [
        (SLIPS, "good", "VALID"),
        (BUS, "medium", "VALID, DEGRADED"),
        (PORT, "high", "VALID, FAULT"),
    ],
)
def test_the_verdict_is_worse_only_where_an_operator_must_act(page, faults, bit, colour, verdict):
    _, browser, _ = page
    wait_for("valid", lambda: text(browser, "#verdict strong") == "VALID")
    faults |= {"health": 1 << bit, "health_now": 1 << bit}
    named = {SLIPS: "slips", BUS: "bus", PORT: "port lost"}[bit]
    wait_for("the fault", lambda: named in text(browser, "#verdict"))
    assert text(browser, "#verdict strong") == verdict
    assert browser.execute_script("return document.querySelector('#verdict').className") == colour
    faults |= {"health_now": 0}
    over = "VALID" if bit == SLIPS else "VALID, WITH A PAST FAULT"
    wait_for("its end", lambda: text(browser, "#verdict strong") == over)
