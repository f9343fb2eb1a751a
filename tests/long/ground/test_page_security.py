"""In a real browser: another site's page reads nothing, and text from the daemon stays text."""

import subprocess
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest

from ground.assets import ENTRY, default_folder
from tests.support.browser import chromium
from tests.support.fake_daemon import FakeDaemon, packet
from tests.support.live_run import ENVIRONMENT, wait_for

MARKUP = "<img src=x onerror=\"document.title='owned'\"><script>document.title='owned'</script>"
EVIL = """<!doctype html><title>waiting</title><script>
const found = [];
const socket = new WebSocket('ws://%s/stream');
socket.onmessage = () => found.push('stream');
socket.onclose = () => fetch('http://%s/objects').then((a) => a.text())
  .then((text) => found.push('objects')).catch(() => 0)
  .then(() => { document.title = found.length ? 'stolen ' + found : 'refused'; });
setTimeout(() => socket.close(), 5000);
</script>"""


class Quiet(SimpleHTTPRequestHandler):
    """Serves files and writes no log."""

    def log_message(self, *_arguments) -> None:
        """Say nothing."""


@pytest.fixture
def gateway():
    """Give the address of a live page whose daemon reports markup as an event."""
    if not (default_folder() / ENTRY).exists():
        pytest.skip("needs Open MCT: ground fetch-assets, or sh tests/setup --all")
    event = packet("event_high", met_s=5.0, event=10, occurrence=1, text=MARKUP)
    with FakeDaemon(stream=lambda: event, period_s=0.4) as daemon:
        command = ["-m", "ground", "--port", str(daemon.port), "serve", "--http-port", "0"]
        process = subprocess.Popen(
            [sys.executable, *command], stdout=subprocess.PIPE, text=True, env=ENVIRONMENT
        )
        try:
            assert process.stdout is not None
            yield process.stdout.readline().strip()
        finally:
            process.terminate()
            process.communicate(timeout=30)


@pytest.fixture
def evil(gateway, tmp_path):
    """Give the address of another site, whose page tries to read."""
    folder = tmp_path / "evil"
    folder.mkdir()
    target = gateway.removeprefix("http://").rstrip("/")
    (folder / "index.html").write_text(EVIL % (target, target))
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://localhost:{server.server_port}/"
    server.shutdown()
    thread.join()
    server.server_close()


def test_another_sites_page_reads_nothing(evil, tmp_path):
    with chromium(tmp_path / "profile") as browser:
        browser.get(evil)
        title = wait_for("an end", lambda: browser.title if browser.title != "waiting" else "")
        assert title == "refused"


def test_markup_in_an_event_is_shown_as_text(gateway, tmp_path):
    with chromium(tmp_path / "profile") as browser:
        browser.get(gateway)
        text = "return document.body.textContent"
        wait_for("the event", lambda: "<img src=x" in browser.execute_script(text))
        assert browser.title != "owned"
        assert browser.execute_script("return document.querySelector('img[src=x]')") is None
