from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from fsw.messages import CARRIED, Block
from fsw.service.blockstore import BlockStoreError, BlockWriter, newest, read_blocks
from tests.support.loop_cases import make_block


def test_blocks_come_back_equal_and_in_order(tmp_path: Path):
    writer = BlockWriter(tmp_path / "b", capacity=8)
    for k in range(5):
        writer.append(make_block(k))
    blocks = read_blocks(tmp_path / "b")
    assert [b.index for b in blocks] == [0, 1, 2, 3, 4]
    for item in fields(Block):
        want = np.asarray(getattr(make_block(3), item.name))
        got = np.asarray(getattr(blocks[3], item.name))
        assert got.dtype == want.dtype
        assert np.array_equal(got, want)


def test_a_store_of_a_robot_without_wheels_holds_nothing_of_them_and_one_with_does(tmp_path: Path):
    plain = make_block(1)
    m = len(plain.t_ns)
    turning = replace(
        plain,
        carried_nms=np.full((m, 4), 2.0),
        carried_nm=np.full((m, 4), 0.1),
        cov_carried=np.stack([np.eye(2 * m)] * 4),
    )
    for name, block in (("plain", plain), ("turning", turning)):
        BlockWriter(tmp_path / name).append(block)
        (again,) = read_blocks(tmp_path / name)
        for key in CARRIED:
            assert np.array_equal(getattr(again, key), getattr(block, key))
        stored = any(key in (tmp_path / name).read_bytes()[:4096].decode() for key in CARRIED)
        assert stored == (name == "turning")


def test_a_full_store_keeps_the_newest(tmp_path: Path):
    writer = BlockWriter(tmp_path / "b", capacity=4)
    for k in range(11):
        writer.append(make_block(k))
    assert [b.index for b in read_blocks(tmp_path / "b")] == [7, 8, 9, 10]


def test_a_row_that_is_being_written_is_left_out(tmp_path: Path):
    writer = BlockWriter(tmp_path / "b", capacity=4)
    for k in range(3):
        writer.append(make_block(k))
    writer._rows["serial"][1] = 0
    assert [b.index for b in read_blocks(tmp_path / "b")] == [0, 2]


@pytest.mark.parametrize(
    "content", [b"", b"[", b"[]".ljust(4096), b"3", b'[["serial", "<i8", []]]'.ljust(5000)]
)
def test_a_file_that_is_no_store_is_refused(tmp_path: Path, content: bytes):
    path = tmp_path / "b"
    path.write_bytes(content)
    with pytest.raises(BlockStoreError):
        read_blocks(path)
    with pytest.raises(BlockStoreError):
        BlockWriter(path, keep=True)


def test_a_store_that_was_cut_is_refused_and_none_is_found_half_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "b"
    writer = BlockWriter(path, capacity=4)
    with monkeypatch.context() as patch:
        patch.setattr("os.posix_fallocate", raising)
        with pytest.raises(OSError, match="no space"):
            writer.append(make_block(0))
    assert not path.exists()
    writer.append(make_block(1))  # there is room again
    assert [b.index for b in read_blocks(path)] == [1]
    path.write_bytes(path.read_bytes()[:4096])
    with pytest.raises(BlockStoreError):
        read_blocks(path)


def raising(*_arguments: object) -> None:
    raise OSError("no space")


def test_a_span_takes_the_newest_seconds():
    blocks = [make_block(k) for k in range(10)]  # 0.4 s apart, 0.3 s from first to last node
    assert [b.index for b in newest(blocks, 1.0)] == [8, 9]
    assert len(newest(blocks, None)) == 10
    assert newest([], 1.0) == []


def test_before_the_first_block_there_is_none_and_old_ones_are_gone(tmp_path: Path):
    BlockWriter(tmp_path / "b").append(make_block(1))
    BlockWriter(tmp_path / "b")
    assert read_blocks(tmp_path / "b") == []


def noisy_angles(index: int) -> Block:
    """A block as a configuration with noisy angles gives it: their covariance beside the rates'."""
    block = make_block(index)
    n, size = len(block.cov_joint), 3 * len(block.t_ns)
    values = np.arange(n * size * size, dtype=float).reshape(n, size, size)
    return replace(block, cov_joint=values)


def test_a_table_that_makes_angles_noisy_changes_no_stored_shape(tmp_path: Path):
    path = tmp_path / "b"
    writer = BlockWriter(path, capacity=8)
    blocks = [make_block(0), noisy_angles(1), make_block(2), noisy_angles(3)]
    size = 0
    for block in blocks:
        writer.append(block)
        size = size or path.stat().st_size
    assert path.stat().st_size == size
    writer = BlockWriter(path, keep=True)
    writer.append(noisy_angles(4))
    found = read_blocks(path)
    assert [b.index for b in found] == [0, 1, 2, 3, 4]
    for got, want in zip(found, [*blocks, noisy_angles(4)], strict=True):
        assert np.array_equal(got.cov_joint, want.cov_joint)


def test_a_block_that_has_no_room_is_refused_and_the_stored_ones_stay(tmp_path: Path):
    writer = BlockWriter(tmp_path / "b", capacity=4)
    writer.append(make_block(0))
    for block in (make_block(1, joints=4), make_block(1, nodes=5)):
        with pytest.raises(BlockStoreError, match="no room"):
            writer.append(block)
    writer.append(make_block(2))
    assert [b.index for b in read_blocks(tmp_path / "b")] == [0, 2]
