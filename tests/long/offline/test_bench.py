"""`fsw bench` on this machine, in its short form: nothing is lost, and ratios hold."""

import json
import subprocess
import sys
from shutil import which

import pytest

from offline.bench import buses

ROUNDS = 1
BUFFER_FRAMES = 2400  # of a stall of 0.3 s on a full bus


@pytest.fixture(scope="module")
def figures() -> dict[str, list[dict]]:
    """Return the figures of one short run, by name."""
    command = [sys.executable, "-m", "fsw", "bench", "--rounds", str(ROUNDS), "--seconds", "1"]
    done = subprocess.run([*command, "--json"], capture_output=True, text=True, check=True)
    assert "round 1 of 1" in done.stderr  # progress
    found: dict[str, list[dict]] = {}
    for figure in json.loads(done.stdout)["figures"]:
        assert len(figure["own"]) == (ROUNDS if "stall" not in figure["name"] else 1)
        found.setdefault(figure["name"], []).append(figure)
    return found


@pytest.mark.parametrize("port", [buses.SOCKET, buses.MULTICAST])
def test_a_full_bus_is_read_without_loss_and_cheaper_than_by_python_can(figures, port) -> None:
    (sent,) = figures[f"{port}: frames sent"]
    assert sent["own"][0] > 4000.0
    (lost,) = figures[f"{port}: frames lost"]
    assert lost["own"] == [0.0]
    by_recv, by_notifier = figures[f"{port}: processor time of a frame"]
    assert by_recv["reference_name"] == buses.RECV
    assert by_recv["ratio"] < 1.0
    assert by_notifier["reference_name"] == buses.NOTIFIER
    assert by_notifier["ratio"] < 1.0


def test_a_stall_of_300_ms_loses_nothing_and_a_longer_one_is_counted_to_the_frame(figures) -> None:
    short, long = (f"{buses.SOCKET}: stall of {stall_s:g} s" for stall_s in buses.STALLS_S)
    assert figures[f"{short}: frames lost"][0]["own"] == [0.0]
    (lost,) = figures[f"{long}: frames lost"]
    assert lost["own"][0] > BUFFER_FRAMES
    assert figures[f"{long}: of these counted"][0]["own"] == lost["own"]


@pytest.mark.skipif(which("cyclictest") is None, reason="needs cyclictest: sh tests/setup --all")
def test_the_line_and_the_timer_stand_beside_their_references(figures) -> None:
    (line,) = figures["serial line: processor time"]
    assert line["ratio"] < 2.0
    names = [f"tick release at 500 Hz, {name}" for name in ("p50", "p99", "max")]
    for side in ("own", "reference"):  # of ours and of cyclictest
        late_us = [figures[name][0][side][0] for name in names]
        assert 0.0 < late_us[0] <= late_us[1] <= late_us[2] < 1e6
