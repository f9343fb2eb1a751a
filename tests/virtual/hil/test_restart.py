"""A daemon that dies in the middle of a motion, one that goes on, and its replay: the same."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsw.exchange.checkpoint import Checkpoint, Identity, decode, encode
from fsw.exchange.checkpoint_store import CheckpointStore, identity_of
from fsw.exchange.restart import Mode, judge
from fsw.exchange.sinks import Fanout
from fsw.messages.commands import Command, CommandName
from fsw.service.checkpoint_keeper import CheckpointKeeper
from fsw.service.recorder import CHECKPOINT, RecorderSink, open_recording
from hil.links.virtual import VirtualBench
from hil.run.bench import Setup
from offline.replay import replay
from tests.support.flown_daemon import Kept, S, bench_of, daemon_on, fly
from tests.support.malformed_cases import CHI2_10_999, normalised_error, short

pytestmark = pytest.mark.timeout(900)
DIES_S, ENDS_S = 15.0, 26.0
PERIOD_S = 2.0


@pytest.fixture(scope="module")
def story(tmp_path_factory: pytest.TempPathFactory) -> tuple[Setup, VirtualBench, Kept]:
    """A run that was killed, and its world."""
    setup = short(tmp_path_factory.mktemp("restart"), seed=2, total_s=ENDS_S)
    service = setup.config.service.model_copy(update={"checkpoint_period_s": PERIOD_S})
    setup = replace(setup, config=setup.config.model_copy(update={"service": service}))
    bench, before = bench_of(setup), Kept()
    fly(daemon_on(setup, bench, before), bench, DIES_S)
    return setup, bench, before


def test_a_restart_goes_on_and_its_replay_is_the_same(
    story: tuple[Setup, VirtualBench, Kept], tmp_path: Path
) -> None:
    setup, bench, before = story
    died_ns = bench.clock.now_ns()
    newest = before.snapshots[-1]
    assert died_ns - newest.t_ns <= PERIOD_S * S  # no more is lost
    data = encode(Checkpoint(identity=Identity(1, 2), sequence=4, boot_id="boot", snapshot=newest))
    recorder = RecorderSink(open_recording(setup.config, tmp_path / "a.mcap"), pytest.fail)
    after = Kept()
    daemon = daemon_on(setup, bench, Fanout(after, recorder))
    recorder.attach(CHECKPOINT, data)
    assert daemon.restart(judge(decode(data), "boot", died_ns, 60.0))
    assert [event.code for event in after.events] == ["STATE_RESTORED"]
    same = before.estimates[before.published - 1]
    restored, sigma = after.estimates[0], np.sqrt(np.diag(same.covariance))
    assert (restored.blocks, restored.valid) == (same.blocks, same.valid)
    # the state is some relinearisation on from what was published last
    assert np.max(np.abs(restored.mean - same.mean) / sigma) < 1.0
    assert np.allclose(np.sqrt(np.diag(restored.covariance)), sigma, rtol=0.05)
    fly(daemon, bench, ENDS_S)
    assert after.snapshots[0].t_ns - died_ns <= 0.1 * S  # a death soon after this loses no more
    final = daemon.shutdown()
    assert final is not None
    assert final.blocks > same.blocks + 20  # 11 s of windows of 0.4 s
    assert normalised_error(setup, final.mean, final.covariance) < CHI2_10_999
    again = replay(tmp_path / "a.mcap", setup.config).estimate
    assert again is not None
    assert np.array_equal(again.mean, final.mean)
    assert np.array_equal(again.covariance, final.covariance)


def test_a_state_that_is_put_back_goes_on_to_the_last_bit(
    story: tuple[Setup, VirtualBench, Kept],
) -> None:
    setup, _, _ = story
    bench, sink, after = bench_of(setup), Kept(), Kept()
    daemon = daemon_on(setup, bench, sink)
    fly(daemon, bench, 8.0)
    sink.snapshots.clear()
    daemon.submit(Command(name=CommandName.SAVE_STATE))
    (kept,) = sink.snapshots
    whole = replace(kept, blocks=tuple(sink.blocks))
    restored = daemon_on(setup, bench_of(setup), after)
    checkpoint = Checkpoint(identity=Identity(1, 2), sequence=1, boot_id="b", snapshot=whole)
    assert restored.restart(judge(decode(encode(checkpoint)), "b", kept.t_ns, 60.0))
    (first,), now = after.estimates, daemon.estimation.estimator.estimate(kept.t_ns)
    assert first.blocks == now.blocks > 10
    assert np.array_equal(first.mean, now.mean)
    assert np.array_equal(first.covariance, now.covariance)


@pytest.mark.parametrize(("boot_id", "later_s"), [("another", 1.0), ("boot", 3600.0)])
def test_after_a_boot_or_a_long_pause_only_the_bodies_hold(
    story: tuple[Setup, VirtualBench, Kept], boot_id: str, later_s: float
) -> None:
    setup, _, before = story
    bench, sink = bench_of(setup), Kept()
    checkpoint = Checkpoint(
        identity=Identity(1, 2), sequence=4, boot_id="boot", snapshot=before.snapshots[-1]
    )
    now_ns = checkpoint.snapshot.t_ns + round(later_s * S)
    found = judge(checkpoint, boot_id, now_ns, 60.0)
    assert found.mode is Mode.BODIES
    daemon = daemon_on(setup, bench, sink)
    cold = daemon.estimation.estimator.estimate(0)
    assert daemon.restart(found)
    was, now = before.estimates[-1], sink.estimates[0]
    k, rest = slice(0, 10), slice(10, None)
    scale = np.sqrt(np.diag(was.covariance))[k]  # of a window or two later
    assert np.all(np.sqrt(np.diag(now.covariance))[k] > 0.9 * scale)
    assert np.all(np.sqrt(np.diag(now.covariance))[k] < 2.0 * scale)
    assert np.max(np.abs(now.mean - was.mean)[k] / scale) < 3.0
    assert np.allclose(now.mean[rest], cold.mean[rest], atol=1e-12)  # biases: as if never seen
    assert np.allclose(now.covariance[rest, rest], cold.covariance[rest, rest], rtol=1e-6)


def test_a_state_of_other_software_is_refused_and_the_start_is_cold(
    story: tuple[Setup, VirtualBench, Kept],
) -> None:
    setup, _, before = story
    state = {k: v for k, v in before.snapshots[-1].state.items() if k != "recursion"}
    spoiled = replace(before.snapshots[-1], state=state)
    checkpoint = Checkpoint(identity=Identity(1, 2), sequence=4, boot_id="b", snapshot=spoiled)
    sink = Kept()
    daemon = daemon_on(setup, bench_of(setup), sink)
    cold = daemon.estimation.estimator.estimate(0)
    assert not daemon.restart(judge(checkpoint, "b", spoiled.t_ns, 60.0))
    assert [event.code for event in sink.events] == ["CHECKPOINT_REFUSED"]
    assert np.array_equal(daemon.estimation.estimator.estimate(0).mean, cold.mean)


def test_the_service_has_every_block_a_state_needs(
    story: tuple[Setup, VirtualBench, Kept], tmp_path: Path
) -> None:
    """What the ring carries, blocks and states apart, is put together again."""
    setup, _, before = story
    keeper = CheckpointKeeper(setup.config, tmp_path, pytest.fail)
    for block in before.blocks:
        keeper.block(block)
    keeper.write(replace(before.snapshots[-1], blocks=()))
    (written,), refused = CheckpointStore(tmp_path, identity_of(setup.config)).read()
    assert refused == []
    assert [b.index for b in written.snapshot.blocks] == list(before.snapshots[-1].refers)
    assert len(written.snapshot.blocks) > 20
    daemon = daemon_on(setup, bench_of(setup), Kept())
    assert daemon.restart(judge(written, written.boot_id, written.snapshot.t_ns, 60.0))
