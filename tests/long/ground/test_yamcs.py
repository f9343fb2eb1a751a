"""Yamcs with the shipped configuration: it decodes, dates, commands and verifies."""

import socket
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from tests.support.live_run import ENVIRONMENT
from tests.support.tool import run_tool
from tests.support.yamcs_server import PYTHON, write_configuration, yamcs

pytestmark = pytest.mark.timeout(900)  # Yamcs starts slowly on a busy machine
STAGES = ("Verifier_Accepted", "Verifier_Start", "Verifier_Complete")


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict[str, Any]:
    """Return what Yamcs has seen and made of its commands."""
    if not PYTHON.exists():
        pytest.skip("needs yamcs in an environment of its own: sh tests/setup --all")
    folder = tmp_path_factory.mktemp("yamcs")
    with socket.create_server(("127.0.0.1", 0)) as free:
        http_port = free.getsockname()[1]
    epoch = datetime.now(UTC) - timedelta(seconds=time.monotonic())
    (folder / "daemon").mkdir()
    command = [sys.executable, "-m", "tests.support.telemetry_alone", str(folder / "daemon")]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=ENVIRONMENT, **pipes) as daemon:
        try:
            assert daemon.stdout is not None
            write_configuration(
                folder / "server",
                http_port=http_port,
                port=int(daemon.stdout.readline()),
                epoch_utc=epoch.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            )
            with yamcs(folder / "server"):
                return run_tool(PYTHON, "yamcs_client.py", http_port, timeout_s=800.0)
        finally:
            daemon.kill()


def sent(found: dict[str, Any], name: str) -> dict[str, Any]:
    return next(item for item in found["sent"] if item["name"] == name)


@pytest.mark.parametrize("name", ["PING", "REPORT_SET"])
def test_a_command_is_verified_stage_by_stage(found, name):
    command = sent(found, name)
    assert command["success"], command
    assert [command["stages"][stage] for stage in STAGES] == ["OK", "OK", "OK"]


def test_a_rejected_command_fails_with_the_daemons_reason(found):
    command = sent(found, "TBL_VALIDATE")
    assert (command["success"], command["error"]) == (False, "NOT_STAGED")
    assert command["stages"]["Verifier_Accepted"] == "NOK"


def test_an_accepted_command_that_fails_is_seen_to_fail(found):
    command = sent(found, "RUN_BATCH")  # there is no loop to run it
    assert (command["success"], command["error"]) == (False, "TIMEOUT")
    assert command["stages"]["Verifier_Accepted"] == "OK"
    assert command["stages"]["Verifier_Complete"] == "NOK"


def test_significance_and_limits_are_the_dictionarys(found):
    assert "CRITICAL" in found["significance"]["RESTART"]
    assert "NONE" in found["significance"]["PING"]
    assert found["values"]["estimate_valid"] == "NO"
    assert found["monitoring"]["estimate_valid"] == "WARNING"
    assert found["monitoring"]["health_met_s"] is None  # it has no limits


def test_packets_have_their_date(found):
    date = datetime.fromisoformat(found["dates"]["health_met_s"])
    assert abs(datetime.now(UTC) - date) < timedelta(minutes=10)
    assert found["link"][0] == "OK"
