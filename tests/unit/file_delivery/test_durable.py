"""Files that survive a crash."""

import os
from pathlib import Path

import pytest

from file_delivery.durable import rename_file, replace_file, write_file


def test_a_file_is_replaced_with_the_permissions_asked_for(tmp_path: Path):
    path = tmp_path / "numbers.json"
    replace_file(path, "old", 0o600)
    replace_file(path, b"new", 0o600)
    assert path.read_bytes() == b"new"
    assert path.stat().st_mode & 0o777 == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_content_is_on_the_disk_before_the_name_and_the_name_before_the_return(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    steps = []
    sync, replace = os.fsync, Path.replace

    def note_sync(descriptor: int) -> None:
        steps.append("sync " + Path(os.readlink(f"/proc/self/fd/{descriptor}")).name)
        sync(descriptor)

    def note_replace(source: Path, target: Path) -> Path:
        steps.append("rename")
        return replace(source, target)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(Path, "replace", note_replace)
    replace_file(tmp_path / "state", "content")
    assert steps == ["sync state.new", "rename", f"sync {tmp_path.name}"]


def test_a_disk_that_fails_leaves_the_old_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "state"
    replace_file(path, "old")

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        replace_file(path, "new")
    assert path.read_text() == "old"


def test_a_shorter_content_leaves_nothing_of_a_longer_one(tmp_path: Path):
    write_file(tmp_path / "a", "a long remainder of a crash")
    write_file(tmp_path / "a", "b")
    rename_file(tmp_path / "a", tmp_path / "b")
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("b", "b")]
