"""The daemon and the devices as processes of their own on real SocketCAN links."""

import itertools
import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader

from fsw.drivers.wire import unpack_frame
from hil.faults.real_bus import ErrorKind, babbling, inject, set_link
from hil.run import bench
from hil.run.flight import on_socketcan
from hil.world.scenario import FOLDER, Scenario
from tests.support.short_cases import LOST_AFTER_S, on_two_buses, short

SYNC_HZ, SLOW_HZ = 200.0, 100.0
NODES = range(0x11, 0x18)
SLOWER = 4.0  # patience of nodes and master: they share one slow processor


@pytest.fixture(scope="module")
def slow(tmp_path_factory):
    """Half the rate, and some rest behind the motion to settle in."""
    made = short(tmp_path_factory.mktemp("slow"), points=2, rate_hz=SLOW_HZ, hurry=2)
    return replace(made, after_s=3.0)


def ip(*words):
    subprocess.run(["ip", "link", *words], check=True)


class Acting:
    """A meter that does something once, 2 s after the daemon's first status."""

    def __init__(self, action) -> None:
        self._action = action

    def update(self, done_s, _summary):
        if done_s > 2.0 and self._action is not None:
            action, self._action = self._action, None
            action()


def run(scenario, folder, action=None, device_end=None):
    """Run plant and daemon, and act on the way.

    `device_end` is the devices' end of a cable whose other end is the configured channel.
    """
    setup = bench.prepare(scenario, 1, folder, real_time=True)
    if device_end is not None:
        bus = scenario.flight["bus"] | {"channel": device_end}
        devices = replace(scenario, flight=scenario.flight | {"bus": bus})
        setup = replace(setup, scenario=devices)
    return bench.run_live(setup, Acting(action))


def recording_of(recorded) -> Path:
    return Path(recorded.extra["recording"])


def frames_of(recording):
    with recording.open("rb") as file:
        for _, _, message in make_reader(file).iter_messages(topics=["/can/arm"]):
            yield unpack_frame(message.log_time, message.data)


def counters(recording, until_ns=None):
    """Return the SYNC counters sent, and by node those echoed, in the order of the recording."""
    sent, echoed = [], {node: [] for node in NODES}
    for frame in frames_of(recording):
        if until_ns is not None and frame.t_ns >= until_ns:
            break
        if frame.is_error:
            continue
        if frame.can_id == 0x080:
            sent.append(frame.data[0])
        elif frame.can_id - 0x180 in echoed and len(frame.data) == 8:
            echoed[frame.can_id - 0x180].append(frame.data[7])
    return sent, echoed


def gaps(values):
    """Return how many counters are missing between neighbours, where any are."""
    steps = [(b - a) % 240 for a, b in itertools.pairwise(values)]
    return [step - 1 for step in steps if step != 1]


def messages_of(recording, topic):
    """Return the messages of a topic that holds JSON."""
    with recording.open("rb") as file:
        messages = make_reader(file).iter_messages(topics=[topic])
        return [json.loads(message.data) for _, _, message in messages]


def switched_at(recording):
    """Return the stamp of the one change of bus, told in full when there were others."""
    events = messages_of(recording, "/events")
    changes = [event for event in events if event["code"] == "BUS_SWITCHED"]
    assert len(changes) == 1, events
    return changes[0]["t_ns"]


def told(recording, *codes):
    """Return the stamps of the live daemon's events of these codes, in order."""
    events = messages_of(recording, "/events")
    return [event["t_ns"] for event in events if event["code"] in codes]


def scenario_file(made: Scenario, folder: Path) -> Path:
    """Write a short motion as a scenario of its own."""
    document = yaml.safe_load((FOLDER / "target_leo.yaml").read_text(encoding="utf-8"))
    document |= {
        "robot": {"urdf": str(made.urdf), "tool_frame": made.tool_frame},
        "bodies_file": str((FOLDER / document["bodies_file"]).resolve()),
        "trajectories": {
            "identification": str(made.identification),
            "verification": str(made.verification),
        },
        "timing": {"before_s": made.before_s, "after_s": made.after_s},
        "sensors": made.sensors,
        "flight": made.flight,
    }
    path = folder / "short_motion.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def typed(tmp_path_factory):
    """Outcome and folder of `hil run --bus socketcan` at 200 Hz, as one types it."""
    folder = tmp_path_factory.mktemp("typed")
    scenario = short(folder, points=2, rate_hz=SYNC_HZ, hurry=2)
    command = [sys.executable, "-m", "hil", "run", str(scenario_file(scenario, folder)), "--json"]
    command += ["--bus", "socketcan", "--out", str(folder / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode in (0, 1), done.stderr  # so short a motion need not end valid
    return json.loads(done.stdout), folder / "out"


def test_a_scenario_runs_over_vcan0_from_the_command_line(typed):
    outcome, folder = typed
    flight = yaml.safe_load((folder / "flight.yaml").read_text(encoding="utf-8"))
    (bus,) = flight["buses"]
    assert (bus["interface"], bus["channel"]) == ("socketcan", "vcan0")
    assert outcome["simulated_s"] > 4.0
    samples = outcome["samples"]["arm"]
    assert samples["received"] > 7 * SYNC_HZ * 4.0
    assert samples["rejected"] == 0
    assert outcome["daemon_exit_code"] == 0


def test_a_run_at_200_hz_loses_nothing_and_publishes_its_estimate(typed):
    (recording,) = (typed[1] / "recording").glob("*.mcap")
    status = messages_of(recording, "/tm")[-1]
    sent, echoed = counters(recording)
    assert len(sent) > 5 * SYNC_HZ
    assert gaps(sent) == []
    for values in echoed.values():
        assert gaps(values) == []  # every SYNC was answered by every node, and seen
        assert len(sent) - len(values) < 0.5 * SYNC_HZ
    assert status["buses"]["arm"] == {"overflow": 0, "unsent": 0}
    assert status["links"]["arm"] == {"up": True, "losses": 0}
    assert told(recording, "PORT_LOST", "CAN_OVERFLOW", "CAN_UNSENT", "ESTIMATOR_RESET") == []
    samples = status["samples"]["arm"]
    assert samples["received"] == sum(map(len, echoed.values()))
    assert samples["received"] == samples["accepted"] + samples["rejected"]
    assert messages_of(recording, "/estimate")  # how promptly is a matter of the machine's load


def test_disturbed_frames_are_counted_and_cost_nothing_and_a_lost_link_comes_back(slow, tmp_path):
    """Error frames and a babbling node, then a link that goes down and up."""

    def disturb():
        inject("vcan0", ErrorKind.ERROR_PASSIVE, ErrorKind.BUS_OFF, ErrorKind.RESTARTED)
        with babbling("vcan0", 0x7E5, 200.0, seed=1) as babble:
            time.sleep(1.0)
        heard.append(babble.sent)
        set_link("vcan0", up=False)
        time.sleep(1.0)
        set_link("vcan0", up=True)

    heard = []
    recorded = run(on_socketcan(slow), tmp_path, disturb)
    recording = recording_of(recorded)
    (lost,), (back,) = told(recording, "PORT_LOST"), told(recording, "PORT_BACK")
    samples = recorded.status["samples"]["arm"]
    for condition in ("can_error_passive", "can_bus_off", "can_restarted"):
        assert samples[condition] == 1
        (t_ns,) = told(recording, condition.upper())
        assert t_ns < lost
    assert samples["error_frames"] == 3
    assert sum(frame.can_id == 0x7E5 for frame in frames_of(recording)) == heard[0] > 20
    _, echoed = counters(recording, until_ns=lost)
    assert [gaps(values) for values in echoed.values()] == [[]] * 7
    assert min(map(len, echoed.values())) > SLOW_HZ

    assert back - lost > 0.9e9
    assert recorded.status["links"]["arm"] == {"up": True, "losses": 1}
    sent, echoed = counters(recording)
    assert gaps(sent) == []  # no SYNC without a port, and the counter goes on
    assert all(values[-1] in sent[-60:] for values in echoed.values())
    assert recorded.estimates[-1].t_ns > back


def test_a_lost_bus_is_changed_for_the_other_and_the_estimate_goes_on(slow, tmp_path):
    recorded = run(
        on_socketcan(on_two_buses(slow, SLOWER)), tmp_path, lambda: set_link("vcan0", up=False)
    )
    set_link("vcan0", up=True)
    recording = recording_of(recorded)
    switched = switched_at(recording)
    (lost,) = told(recording, "PORT_LOST")
    assert lost <= switched
    assert recorded.status["buses"]["arm"]["active"] == "redundant"
    sent, echoed = counters(recording)
    assert gaps(sent) == []
    for values in echoed.values():
        assert len(gaps(values)) <= 1  # until the nodes have toggled; none if that is quick
    assert recorded.estimates[-1].t_ns > switched
    assert recorded.extra["daemon_exit_code"] == 0


def test_a_bus_cut_without_a_word_is_left_when_the_nodes_fall_silent(slow, tmp_path):
    """The daemon's end of a cable stays up, so only heartbeat and silence tell."""
    ip("add", "dev", "vxcan0", "type", "vxcan", "peer", "name", "vxcan1")
    try:
        for end in ("vxcan0", "vxcan1"):
            set_link(end, up=True)
        pair = on_socketcan(on_two_buses(slow, SLOWER))
        bus = pair.flight["bus"] | {"channel": "vxcan0"}
        pair = replace(pair, flight=pair.flight | {"bus": bus})
        recorded = run(pair, tmp_path, lambda: set_link("vxcan1", up=False), device_end="vxcan1")
    finally:
        ip("delete", "dev", "vxcan0")
    recording = recording_of(recorded)
    assert told(recording, "PORT_LOST") == []
    switched = switched_at(recording)
    assert recorded.status["buses"]["arm"]["active"] == "redundant"
    sent, echoed = counters(recording)
    assert gaps(sent) == []
    for values in echoed.values():
        (gap,) = gaps(values)
        assert gap >= SLOWER * LOST_AFTER_S * SLOW_HZ
        assert len(values) > 240  # and they came back
    assert recorded.estimates[-1].t_ns > switched
