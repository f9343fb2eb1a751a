"""RUN_PLAN over TCP to its end: commanded, planned on board, announced, fetched, within limits."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pytest

from fsw.config import load
from fsw.estimators.model.inertia import to_parameters
from ground.downlink import ClearStream
from ground.telemetry import TelemetryDecoder
from planner import spline
from planner.limits import load as load_limits
from planner.subject import build_subject
from planner.verify import every_limit
from tests.support.excitation_cases import LIMITS_FILE
from tests.support.live_run import LiveRun, ground, wait_for
from tests.support.tour import Tour

pytestmark = pytest.mark.timeout(900)  # a job of nice 19 beside all other tests

DURATION_S = 8.0
ASKED = (f"duration_s={DURATION_S}", "starts=1", "seed=1")
SETTINGS = (
    f"flight.excitation={{limits: {LIMITS_FILE.resolve()}}}",
    "timing.after_s=1200",  # the arm rests long after its motion: the bench must not end first
    "flight.bus.rate_hz=200",
    "flight.tick_rate_hz=200",
    "sensors.imu.rate_hz=125",
)
DENSE_HZ = 100.0
BODIES_SLACK = 0.05  # of limits of the dynamics, planned for the estimate, judged at the truth


@pytest.fixture
def live(tmp_path: Path) -> Iterator[LiveRun]:
    run = LiveRun(tmp_path, SETTINGS)
    yield run
    run.close()


def events(live: LiveRun) -> list[str]:
    """Return the texts of the events that have come down so far."""
    decoder, stream = TelemetryDecoder(), ClearStream()
    stream.add(bytes(live.raw))
    told = (decoder.decode(raw) for raw in stream.packets())
    return [str(t.values["text"]) for t in told if t is not None and "text" in t.values]


def planned(live: LiveRun) -> CompletedProcess[str]:
    """Return the answer to RUN_PLAN; an estimate that has just become valid may move again."""
    while True:
        tour = Tour(live)
        while tour.wait("estimate").values["valid"] != "YES":
            pass
        tour.close()
        told = ground(live, "tc", "RUN_PLAN", *ASKED, timeout_s=600)
        if "NOT_CONVERGED" not in told.stdout:
            return told


def test_a_motion_is_planned_on_board_and_fetched_over_the_link(live: LiveRun, tmp_path: Path):
    told = planned(live)
    assert told.returncode == 0, told.stdout + told.stderr
    (text,) = wait_for(
        "PLAN_WRITTEN", lambda: [t for t in events(live) if t.startswith("plans/plan_0001.yaml")]
    )
    before, _, after = text.split("mass_kg ")[1].split(",")[0].split(" ")
    assert float(after) < float(before)
    own = tmp_path / "second.yaml"
    got = ground(live, "file", "get", "files/plans/plan_0001.yaml", str(own))
    assert got.returncode == 0, got.stdout + got.stderr
    assert own.read_bytes() == (live.state / "files" / "plans" / "plan_0001.yaml").read_bytes()

    subject = build_subject(load(live.config_path))
    truth = live.scenario.truth["target"]
    x = to_parameters(truth[0], truth[1:4], truth[4:])
    motion = spline.load(own)
    assert motion.duration_s == DURATION_S
    assert np.ptp(motion.points_rad, axis=0).max() > 0.01
    uses = every_limit(replace(subject, x=x), load_limits(LIMITS_FILE), None, motion, DENSE_HZ, [x])
    for use in uses:
        slack = 0.0 if use.kind.startswith("joint") else BODIES_SLACK
        assert use.excess <= slack, use.text()
    assert live.daemon.poll() is None
