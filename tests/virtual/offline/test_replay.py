"""The daemon on simulated devices in virtual time, recorded, and the recording replayed."""

import json
from pathlib import Path

import numpy as np
import pytest

from fsw.__main__ import main
from fsw.config import Config
from fsw.drivers.wire import ByteChunk, CanFrame, frame_array
from fsw.errors import ConfigError
from fsw.exchange.recording import messages
from fsw.exchange.recording_writer import RecordingWriter
from fsw.exchange.sinks import CanTraffic, Fanout, SerialTraffic
from fsw.loop.ports import Ports
from fsw.messages.commands import Command, CommandName
from fsw.service.recorder import RecorderSink, estimate_values, open_recording, recorded_config
from hil.devices.plant import Plant
from hil.links.virtual import VirtualBench
from hil.run.daemon import Daemon
from offline.replay import replay
from offline.span import Span
from tests.conftest import ArmProject, arm_urdf
from tests.support.loop_cases import KeepSink, arm_config
from tests.support.plant_cases import AnalyticHistory, sensor_config

T0 = 5_000_000
TICKS = 2000  # 4 s
FRAMES = ("/can/arm", "/serial/imu", "/serial/star_tracker")


Live = tuple[Config, Path, KeepSink, dict]


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Live:
    """Four seconds of a slow seven-joint arm, with a reset on the way."""
    return fly(tmp_path_factory.mktemp("live"), {1300: Command(name=CommandName.RESET, id=1)})


def fly(folder: Path, commands: dict[int, Command]) -> Live:
    arm = ArmProject(folder, 7)
    for joint in arm.data["joints"]:
        joint["speed_limit_rad_s"] = 10.0
    config = arm_config(arm, estimator={"settle_blocks": 2}, health={"stuck": False})
    world = VirtualBench(Plant(AnalyticHistory(), sensor_config(), 3, t0_ns=T0), T0, seed=3)
    keep = KeepSink()
    path = folder / "live.mcap"
    recorder = RecorderSink(open_recording(config, path), lambda *text: pytest.fail(str(text)))
    ports = Ports(can={"arm": world.can}, imu=world.imu, star_tracker=world.star_tracker)
    daemon = Daemon(config, world.clock, ports, Fanout(keep, recorder))
    for tick in range(TICKS):
        if tick in commands:
            daemon.submit(commands[tick])
        daemon.step()
    daemon.shutdown()
    status = daemon.status()
    return config, path, keep, status


def assert_same(a: KeepSink, b: KeepSink) -> None:
    assert len(a.estimates) == len(b.estimates) > 5
    for x, y in zip(a.estimates, b.estimates, strict=True):
        assert json.dumps(estimate_values(x)) == json.dumps(estimate_values(y))
        assert np.array_equal(x.mean, y.mean)
        assert np.array_equal(x.covariance, y.covariance)


def test_rest_and_another_robot_are_replayed_where_they_were(tmp_path: Path):
    urdf = arm_urdf(7).replace('mass value="3"', 'mass value="4"')
    changes = {"urdf_text": urdf, "noise": {"joints": {"axis1": {"torque_noise_nm": 0.5}}}}
    commands = {
        700: Command(name=CommandName.REST, id=1),
        1000: Command(name=CommandName.RESUME, id=2),
        1400: Command(name=CommandName.CONFIGURE, id=3, args=changes),
    }
    config, path, keep, _ = fly(tmp_path, commands)
    assert [e.blocks for e in keep.estimates][:5] == [1, 2, 3, 4, 1]
    again = KeepSink()
    replay(path, config, sink=again)
    assert_same(keep, again)
    _, _, plain, _ = fly(tmp_path, dict(list(commands.items())[:2]))
    assert not np.allclose(plain.estimates[-1].mean, keep.estimates[-1].mean)


def test_the_virtual_run_loses_nothing_and_uses_its_windows(live):
    _, _, keep, status = live
    for source in ("arm", "imu", "star_tracker"):
        counts = status["samples"][source]
        assert (counts["lost"], counts["late"], counts["rejected"]) == (0, 0, 0)
        assert counts["received"] > 0
    assert status["slips"] == 0
    assert status["windows"]["closed"] == 9
    assert len(keep.blocks) >= 7


def test_a_replay_gives_bit_for_bit_the_estimates_of_the_run(live):
    config, path, keep, status = live
    again = KeepSink()
    result = replay(path, config, sink=again)
    assert_same(keep, again)
    assert result.status["samples"] == status["samples"]
    assert not result.truncated
    assert result.dropped == 0


def test_the_recording_carries_what_a_replay_needs(live, tmp_path: Path):
    _, path, keep, _ = live
    again = KeepSink()
    replay(path, recorded_config(path, tmp_path), sink=again)
    assert_same(keep, again)


def test_the_json_of_a_replay_has_the_words_of_every_command(live):
    config, path, _, _ = live
    values = json.loads(json.dumps(replay(path, config).to_json()))
    assert set(values) >= {"unknown", "method", "estimate", "sigma", "samples", "wall_s"}
    assert set(values["estimate"]["target"]) == {"mass_kg", "com_m", "inertia_kg_m2"}
    assert len(values["sigma"]["target"]["inertia_kg_m2"]) == 6
    assert set(values["samples"]["imu"]) >= {"received", "lost", "late", "rejected"}
    assert "target.mass_kg" in replay(path, config).to_text()


def foreign(live, path: Path, shift_ns: int, topics=FRAMES, chunk: int = 0) -> Path:
    """The raw channels alone, as another recorder on another clock would have written them."""
    writer = RecordingWriter(path)
    for record in messages(live[1], topics):
        kind, name = record.topic.split("/")[1:]
        encoding = {"can": "socketcan", "serial": "raw"}[kind]
        writer._add(f"/{kind}/{name}", encoding, record.t_ns + shift_ns, record.data)
    if chunk:
        writer.traffic(CanTraffic("arm", frame_array([CanFrame(1, 0x7FF, b"")])))
    writer.close()
    return path


def test_a_foreign_recording_in_unix_time_gives_the_same_numbers(live, tmp_path: Path):
    config, _, keep, _ = live
    again = KeepSink()
    replay(foreign(live, tmp_path / "f.mcap", 1_790_000_000_000_000_000), config, sink=again)
    first = keep.estimates[:2]  # before the reset, which is not in the foreign file
    for x, y in zip(first, again.estimates, strict=False):
        assert np.allclose(x.mean, y.mean, rtol=1e-9, atol=1e-12)


def test_a_missing_channel_is_named_with_those_found(live, tmp_path: Path):
    path = foreign(live, tmp_path / "f.mcap", 0, FRAMES[:1])
    with pytest.raises(ConfigError, match=r"no channel /serial/imu.*found: /can/arm"):
        replay(path, live[0])


def test_a_recording_without_sync_is_refused(live, tmp_path: Path):
    writer = RecordingWriter(tmp_path / "f.mcap")
    frames = frame_array(CanFrame(k, 0x191, bytes(8)) for k in range(5))
    writer.traffic(CanTraffic("arm", frames))
    writer.traffic(SerialTraffic("imu", [ByteChunk(3, b"x")]))
    writer.traffic(SerialTraffic("star_tracker", [ByteChunk(3, b"x")]))
    writer.close()
    with pytest.raises(ConfigError, match="no SYNC"):
        replay(tmp_path / "f.mcap", live[0])


def test_a_truncated_recording_replays_up_to_the_break(live, tmp_path: Path):
    config, path, keep, _ = live
    data = path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * 3 // 4])
    again = KeepSink()
    result = replay(tmp_path / "cut.mcap", config, sink=again)
    assert result.truncated
    assert 2 <= len(again.estimates) < len(keep.estimates)
    assert np.array_equal(again.estimates[0].mean, keep.estimates[0].mean)


def test_a_part_of_a_recording_is_replayed_from_its_own_start(live):
    config, path, _, status = live
    part = replay(path, config, span=Span(1.0, 2.0))
    used, whole = part.status["samples"]["imu"]["received"], status["samples"]["imu"]["received"]
    assert used == pytest.approx(whole / 4, abs=2)
    assert part.status["windows"]["closed"] < status["windows"]["closed"]
    with pytest.raises(ConfigError, match="no message of its sensors between 50 s and its end"):
        replay(path, config, span=Span(50.0))


@pytest.mark.parametrize("bounds", [(-1.0, 2.0), (2.0, 2.0), (float("nan"), 2.0)])
def test_a_span_that_holds_nothing_is_refused(bounds):
    with pytest.raises(ConfigError, match=r"--(from|to): "):
        Span(*bounds)


def test_events_and_health_of_a_replay_are_shown(live):
    config, path, keep, _ = live
    result = replay(path, config)
    values = result.to_json()
    found, live_codes = (
        [event["code"] for event in values["events"]],
        [e.code for e in keep.events],
    )
    assert sorted([*found, "STOPPED"]) == sorted(live_codes)  # of the loop, which a replay has not
    assert "faulty" in values["health"]
    assert f"{len(found)} events" in result.to_text()


def test_a_replay_without_a_valid_estimate_exits_with_1(live, capsys):
    config, path, keep, _ = live
    assert not keep.estimates[0].valid
    configuration = str(config.resolve(Path("config.yaml")))
    assert main(["replay", str(path), "--config", configuration, "--to", "1"]) == 1
    assert "not valid: " in capsys.readouterr().out


def test_the_method_and_its_weighting_are_chosen_on_the_command_line(live, capsys):
    config, path, _, _ = live
    arguments = [str(path), "--config", str(config.resolve(Path("config.yaml")))]
    main(["replay", *arguments, "--method", "mrnea", "--weighting", "eiv", "--json"])
    assert json.loads(capsys.readouterr().out)["method"] == "mrnea"
    main(["identify", *arguments, "--method", "mrnea", "--weighting", "wls", "--json"])
    assert "shrunk" in json.loads(capsys.readouterr().out)["note"]
    assert main(["identify", *arguments, "--weighting", "wls"]) == 2
    assert "--weighting wls: only mrnea has one" in capsys.readouterr().err
