"""A process killed at every step of keeping a table or parameters leaves the old or the new one."""

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from fsw.telemetry.state.store import GenerationStore

OLD, NEW = b"old" * 1000, b"new" * 2000


def count_and_kill(steps: list[int], at: int) -> Callable[[str, tuple], None]:
    """An audit hook that kills this process at the at-th file event."""

    def hook(event: str, _arguments: tuple) -> None:
        if event in ("open", "os.rename", "os.remove", "os.mkdir", "os.listdir", "os.scandir"):
            steps[0] += 1
            if steps[0] == at:
                os.kill(os.getpid(), signal.SIGKILL)

    return hook


def killed_at(folder: Path, at: int) -> bool:
    """Write a new generation in a child that dies at its at-th file event; True if it died."""
    child = os.fork()
    if child == 0:
        sys.addaudithook(count_and_kill([0], at))
        GenerationStore(folder).write(NEW)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


def test_a_kill_at_every_file_event_leaves_the_old_or_the_new(tmp_path: Path):
    found = set()
    for at in range(1, 40):
        folder = tmp_path / f"{at}"
        store = GenerationStore(folder)
        for content in (b"older", b"old", OLD):  # full: the next write also removes one
            store.write(content)
        died = killed_at(folder, at)
        generations, damaged = store.read()
        assert damaged == 0
        assert generations[0].content in (OLD, NEW)
        found.add(generations[0].content)
        again = store.write(b"after")
        assert store.read()[0][0].content == b"after"
        assert again == generations[0].number + 1
        if not died:
            break
    assert found == {OLD, NEW}
    assert not died


@pytest.mark.parametrize("length", [0, 1, 17, 18, 19, 500, 5999, 6017])
def test_a_file_that_holds_only_a_part_is_not_taken(tmp_path: Path, length: int):
    """What a power cut may leave of a file whose blocks were not all on the disk."""
    store = GenerationStore(tmp_path)
    store.write(OLD)
    number = store.write(NEW)
    path = tmp_path / f"{number:08d}.gen"
    path.write_bytes(path.read_bytes()[:length])
    generations, damaged = store.read()
    assert (generations[0].content, damaged) == (OLD, 1)


def test_every_flipped_bit_of_a_generation_is_seen(tmp_path: Path):
    store = GenerationStore(tmp_path)
    number = store.write(b"content")
    path = tmp_path / f"{number:08d}.gen"
    good = path.read_bytes()
    for bit in range(8 * len(good)):
        data = bytearray(good)
        data[bit // 8] ^= 1 << (bit % 8)
        path.write_bytes(data)
        assert store.read() == ([], 1)


def test_what_was_only_prepared_is_not_there(tmp_path: Path):
    store = GenerationStore(tmp_path)
    store.write(OLD)
    store.prepare(NEW)
    assert store.read()[0][0].content == OLD
    store.discard()
    assert store.write(NEW) == 2
