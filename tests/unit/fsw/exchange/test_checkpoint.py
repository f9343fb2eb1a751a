"""Checkpoints: what is written comes back, and what is not whole or not ours is refused."""

import struct
import time
import zlib
from dataclasses import replace
from pathlib import Path

import msgpack
import numpy as np
import pytest

from fsw.clock import boot_id
from fsw.config.overlay import overlay
from fsw.exchange.checkpoint import (
    Checkpoint,
    CheckpointError,
    Identity,
    decode,
    encode,
    sequence_of,
)
from fsw.exchange.checkpoint_store import CheckpointStore, identity_of
from fsw.exchange.restart import Mode, judge
from fsw.messages import Snapshot
from fsw.service.checkpoint_keeper import CheckpointKeeper
from tests.conftest import ArmProject
from tests.support.loop_cases import arm_config, make_block

OURS = Identity(0x1234, 0x5678)
STATE = {
    "kind": "online",
    "whole": -3,
    "real": float("inf"),
    "flag": True,
    "nothing": None,
    "words": ["a", "b"],
    "matrix": np.arange(6.0).reshape(2, 3),
    "inner": {"mask": np.array([True, False]), "empty": np.zeros((0, 4))},
}


def snapshot(t_ns: int = 9) -> Snapshot:
    return Snapshot(t_ns=t_ns, grid_ns=-5, state=STATE, blocks=(make_block(3), make_block(4)))


def made(sequence: int = 7, identity: Identity = OURS) -> bytes:
    return encode(
        Checkpoint(identity=identity, sequence=sequence, boot_id="boot", snapshot=snapshot())
    )


def test_wheels_are_kept_where_there_are_some_and_nothing_of_them_where_there_are_none() -> None:
    plain = make_block(3)
    turning = replace(plain, carried_nms=np.ones((4, 2)), cov_carried=np.ones((2, 8, 8)))
    checkpoint = Checkpoint(
        identity=OURS,
        sequence=1,
        boot_id="b",
        snapshot=replace(snapshot(), blocks=(plain, turning)),
    )
    data = encode(checkpoint)
    first, second = decode(data, OURS).snapshot.blocks
    assert not first.carried_nms.size
    assert np.array_equal(second.cov_carried, turning.cov_carried)
    assert b"carried_nms" not in made()


def test_what_is_written_comes_back() -> None:
    again = decode(made(), OURS)
    assert (again.identity, again.sequence, again.boot_id) == (OURS, 7, "boot")
    assert (again.snapshot.t_ns, again.snapshot.grid_ns) == (9, -5)
    state = again.snapshot.state
    assert np.array_equal(state["matrix"], STATE["matrix"])
    assert state["inner"]["mask"].dtype == bool
    assert state["inner"]["empty"].shape == (0, 4)
    plain = {k: v for k, v in STATE.items() if k not in ("matrix", "inner")}
    assert {k: state[k] for k in plain} == plain
    assert [block.index for block in again.snapshot.blocks] == [3, 4]
    assert np.array_equal(again.snapshot.blocks[0].t_ns, make_block(3).t_ns)
    assert encode(again) == made()


def test_every_single_bit_flip_is_refused() -> None:
    data = made()
    for bit in range(0, 8 * len(data), 7):  # 7: every byte, every bit of it in turn
        spoiled = bytearray(data)
        spoiled[bit // 8] ^= 1 << bit % 8
        with pytest.raises(CheckpointError):
            decode(bytes(spoiled), OURS)


@pytest.mark.parametrize("length", [0, 1, 33, 34, 60, -4, -1])
def test_a_file_cut_anywhere_is_refused(length: int) -> None:
    with pytest.raises(CheckpointError, match="damaged"):
        decode(made()[:length], OURS)


@pytest.mark.parametrize(
    ("identity", "why"),
    [(Identity(1, 0x5678), "another configuration"), (Identity(0x1234, 1), "another robot")],
)
def test_a_foreign_one_is_refused_by_name(identity: Identity, why: str) -> None:
    with pytest.raises(CheckpointError, match=why):
        decode(made(), identity)
    assert decode(made()).identity == OURS  # asked for any


def test_another_version_is_refused_whatever_is_in_it() -> None:
    data = bytearray(made()[:-4])
    struct.pack_into("<H", data, 8, 0)
    whole = bytes(data) + struct.pack("<I", zlib.crc32(data))
    with pytest.raises(CheckpointError, match="format version 0"):
        decode(whole, OURS)
    assert sequence_of(whole) == 7  # and yet it will be overwritten in its turn


def test_an_array_that_would_run_code_is_refused() -> None:
    data = made().replace(b"<f8", b"|O8", 1)[:-4]
    with pytest.raises(CheckpointError, match="body cannot be read"):
        decode(data + struct.pack("<I", zlib.crc32(data)), OURS)


def spoiled(body: object) -> bytes:
    """A file around any body, length and check value right."""
    packed = msgpack.packb(body)
    head = made()[:26] + struct.pack("<Q", len(packed))
    return head + packed + struct.pack("<I", zlib.crc32(head + packed))


WHOLE = {
    "boot_id": "boot",
    "t_ns": 1,
    "grid_ns": None,
    "state": {},
    "changes": [],
    "identifying": True,
    "blocks": [],
}
ARRAY = msgpack.ExtType(1, msgpack.packb(["<f8", [1], b"12345678"]))


def test_a_whole_body_is_read() -> None:
    assert decode(spoiled(WHOLE), OURS).snapshot.t_ns == 1


@pytest.mark.parametrize(
    "body",
    [
        ARRAY,
        [],
        None,
        WHOLE | {"t_ns": float("inf")},
        WHOLE | {"grid_ns": float("nan")},
        WHOLE | {"changes": 3},
        WHOLE | {"blocks": {"index": 1}},
        WHOLE | {"blocks": [{"index": float("inf")}]},
        WHOLE | {"blocks": [ARRAY]},
        WHOLE | {"state": ARRAY},
        *(
            WHOLE | {"state": {"x": msgpack.ExtType(1, msgpack.packb(parts))}}
            for parts in (
                ["<f8", [1], 1 << 62],
                ["<f8", [float("inf")], b"12345678"],
                ["<f8", [2], b"12345678"],
                ["<f8", 1, b"12345678"],
                3,
            )
        ),
    ],
)
def test_a_body_of_another_shape_is_refused(body: object) -> None:
    with pytest.raises(CheckpointError, match="body cannot be read"):
        decode(spoiled(body), OURS)


def test_generations_take_turns_and_the_newest_comes_first(tmp_path: Path) -> None:
    store = CheckpointStore(tmp_path, OURS)
    for t_ns in (1, 2, 3):
        store.write(snapshot(t_ns))
    good, refused = store.read()
    assert [(c.sequence, c.snapshot.t_ns) for c in good] == [(2, 3), (1, 2)]
    assert refused == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["checkpoint.0", "checkpoint.1"]
    later = CheckpointStore(tmp_path, OURS)  # of the next process
    later.write(snapshot(4))
    assert [c.sequence for c in later.read()[0]] == [3, 2]


def test_a_damaged_newest_falls_back_to_the_older_and_is_replaced_first(tmp_path: Path) -> None:
    store = CheckpointStore(tmp_path, OURS)
    store.write(snapshot(1))
    store.write(snapshot(2))
    newest = tmp_path / "checkpoint.1"
    newest.write_bytes(newest.read_bytes()[:-1])
    good, refused = store.read()
    assert [c.snapshot.t_ns for c in good] == [1]
    assert refused == [text for text in refused if text.startswith("checkpoint.1: damaged")] != []
    later = CheckpointStore(tmp_path, OURS)
    later.write(snapshot(3))
    assert [c.snapshot.t_ns for c in later.read()[0]] == [3, 1]


def test_a_foreign_generation_is_refused_and_still_outnumbered(tmp_path: Path) -> None:
    CheckpointStore(tmp_path, Identity(9, 9)).write(snapshot(1))
    store = CheckpointStore(tmp_path, OURS)
    assert store.read()[0] == []
    store.write(snapshot(2))
    good, refused = store.read()
    assert [c.sequence for c in good] == [1]
    assert "another configuration" in refused[0]


def test_the_keeper_joins_states_and_blocks_and_forgets_what_no_state_needs(
    arm: ArmProject, tmp_path: Path
) -> None:
    told: list[str] = []
    config = arm_config(arm)
    keeper = CheckpointKeeper(config, tmp_path, lambda _s, code, _t: told.append(code))
    for index in range(6):
        keeper.block(make_block(index))
    keeper.write(Snapshot(t_ns=1, grid_ns=0, state={}, refers=(1, 4)))
    store = CheckpointStore(tmp_path, identity_of(config))
    assert [b.index for b in store.read()[0][0].snapshot.blocks] == [1, 4]
    keeper.write(Snapshot(t_ns=2, grid_ns=0, state={}, refers=(4, 5)))
    assert keeper.summary()["written"] == 2
    keeper.write(replace(snapshot(3), refers=(2,)))
    keeper.write(replace(snapshot(3), refers=(2,)))
    assert (told, keeper.summary()["failed"]) == (["CHECKPOINT_FAILED"], 2)


def test_the_keeper_takes_over_what_a_run_goes_on_from(arm: ArmProject, tmp_path: Path) -> None:
    config = arm_config(arm)
    first = CheckpointKeeper(config, tmp_path, pytest.fail)
    first.block(make_block(2))
    first.write(Snapshot(t_ns=1, grid_ns=0, state={}, refers=(2,)))
    second = CheckpointKeeper(config, tmp_path, pytest.fail)
    assert second.adopt(5) is None
    data = second.adopt(0)
    assert data == (tmp_path / "checkpoint.0").read_bytes()
    second.block(make_block(3))
    second.write(Snapshot(t_ns=2, grid_ns=0, state={}, refers=(2, 3)))
    assert second.summary()["written"] == 1


@pytest.mark.parametrize(("grid_ns", "written"), [(0, 1), (1, 0)])
def test_a_service_that_has_died_leaves_its_blocks_in_its_checkpoints(
    arm: ArmProject, tmp_path: Path, grid_ns: int, written: int
) -> None:
    """The next one has only the blocks of this run, not those the run went on from."""
    told: list[str] = []
    config = arm_config(arm)
    first = CheckpointKeeper(config, tmp_path, pytest.fail)
    first.block(make_block(2))
    first.write(Snapshot(t_ns=1, grid_ns=0, state={}, refers=(2,)))
    second = CheckpointKeeper(config, tmp_path, lambda _s, code, _t: told.append(code))
    second.block(make_block(3))
    second.write(Snapshot(t_ns=2, grid_ns=grid_ns, state={}, refers=(2, 3)))
    assert second.summary()["written"] == written
    assert told == ["CHECKPOINT_FAILED"] * (1 - written)


def test_a_directory_that_cannot_be_written_is_told_once(arm: ArmProject, tmp_path: Path) -> None:
    told: list[str] = []
    keeper = CheckpointKeeper(
        arm_config(arm), tmp_path / "absent", lambda _s, code, _t: told.append(code)
    )
    for t_ns in range(3):
        keeper.write(Snapshot(t_ns=t_ns, grid_ns=0, state={"after": 0}))
    assert (told, keeper.summary()["failed"]) == (["CHECKPOINT_FAILED"], 3)


def test_a_checkpoint_made_under_other_noise_is_foreign(arm: ArmProject, tmp_path: Path) -> None:
    config = arm_config(arm)
    noise = {"joints": {"axis2": {"torque_noise_nm": 0.3}}}
    changed = overlay(config, {"noise": noise})
    assert identity_of(overlay(config, {"noise": {}})) == identity_of(config)
    keeper = CheckpointKeeper(config, tmp_path, pytest.fail)
    keeper.write(snapshot(1))
    keeper.configured(changed)  # activated while it runs
    keeper.write(snapshot(2))
    for taken, t_ns in ((config, 1), (changed, 2)):
        good, refused = CheckpointStore(tmp_path, identity_of(taken)).read()
        assert [c.snapshot.t_ns for c in good] == [t_ns]
        assert "another configuration" in refused[0]


def test_a_checkpoint_from_before_a_suspend_tells_no_age(tmp_path: Path, monkeypatch) -> None:
    store = CheckpointStore(tmp_path, OURS, boot_id)
    store.write(snapshot())
    (kept,), _ = store.read()
    seconds = 5_000_000_000
    found = judge(kept, boot_id(), snapshot().t_ns + seconds, hold_s=60.0)
    assert (found.mode, found.age_s) == (Mode.EXACT, 5.0)
    # the machine sleeps for an hour: CLOCK_MONOTONIC stands still, CLOCK_BOOTTIME does not
    now_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) + 3600 * 10**9
    monkeypatch.setattr(time, "clock_gettime_ns", lambda _clock: now_ns)
    found = judge(kept, boot_id(), snapshot().t_ns + seconds, hold_s=60.0)
    assert (found.mode, found.age_s) == (Mode.BODIES, None)


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"\x90" * 5,
        b"\x91" * 100_000,
        msgpack.packb({}),
        msgpack.packb({"blocks": [{"index": 1}], "state": {}, "t_ns": 1, "grid_ns": 1}),
        msgpack.packb({"blocks": [[]], "t_ns": 2**63, "grid_ns": -1, "state": [], "changes": 1}),
    ],
)
def test_a_right_crc_around_wrong_content_is_refused(body: bytes) -> None:
    head = struct.Struct("<8sHIIQQ").pack(b"FSWCKPT\n", version(), 0x1234, 0x5678, 7, len(body))
    whole = head + body + struct.pack("<I", zlib.crc32(head + body))
    with pytest.raises(CheckpointError, match="damaged"):
        decode(whole, OURS)


def version() -> int:
    return int(struct.unpack_from("<H", made(), 8)[0])
