"""Fetching public recordings: from a server on this machine, with the bytes they must have."""

import hashlib
import subprocess
import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from evidence.hardware.data_set import DataError, DataSet

BYTES = b"1 2 3\n"


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def server(tmp_path: Path) -> Iterator[str]:
    (tmp_path / "served/own er/c0/a b").mkdir(parents=True)
    (tmp_path / "served/own er/c0/a b/q.txt").write_bytes(BYTES)
    handler = partial(Quiet, directory=str(tmp_path / "served"))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{running.server_port}"
        running.shutdown()


def data_set(sha256: str = hashlib.sha256(BYTES).hexdigest()) -> DataSet:
    return DataSet(
        what="", repository="own%20er", commit="c0", licence="MIT", files={"a b/q.txt": sha256}
    )


def test_a_file_is_loaded_once_and_named_with_its_licence(server, tmp_path):
    told: list[str] = []
    data_set().fetch(tmp_path, told.append, raw=server)
    assert data_set().read(tmp_path, "a b/q.txt").read_bytes() == BYTES
    assert told == [f"{server}/own%20er/c0/a%20b/q.txt (MIT)"]
    data_set().fetch(tmp_path, told.append, raw="http://127.0.0.1:1")
    assert len(told) == 1


def test_other_bytes_are_refused_and_not_kept(server, tmp_path):
    wrong = data_set("0" * 64)
    with pytest.raises(DataError, match="SHA-256"):
        wrong.fetch(tmp_path, lambda _: None, raw=server)
    with pytest.raises(DataError, match="not there; --fetch"):
        wrong.read(tmp_path, "a b/q.txt")
    data_set().fetch(tmp_path, lambda _: None, raw=server)
    with pytest.raises(DataError, match="SHA-256"):
        wrong.read(tmp_path, "a b/q.txt")


def test_no_server_is_one_line(tmp_path):
    with pytest.raises(DataError, match="cannot be loaded") as caught:
        data_set().fetch(tmp_path, lambda _: None, raw="http://127.0.0.1:1")
    assert len(str(caught.value).splitlines()) == 1


def git(folder: Path, *arguments: str) -> str:
    who = ("-c", "user.name=x", "-c", "user.email=x@example.org")
    command = ["git", "-C", str(folder), *who, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_a_local_repository_gives_a_file_of_an_old_commit(tmp_path):
    """The newest commit holds other bytes; a repository without the commit is passed over."""
    repositories = [tmp_path / "other", tmp_path / "own"]
    for repository in repositories:
        (repository / "a b").mkdir(parents=True)
        git(tmp_path, "init", "-q", str(repository))
    place = repositories[1] / "a b/q.txt"
    for content in (BYTES, b"later\n"):
        place.write_bytes(content)
        git(repositories[1], "add", ".")
        git(repositories[1], "commit", "-q", "-m", "x")
    own = replace(data_set(), commit=git(repositories[1], "rev-parse", "HEAD~1"))
    own.fetch(tmp_path / "data", lambda _: None, repositories, raw="http://127.0.0.1:1")
    assert own.read(tmp_path / "data", "a b/q.txt").read_bytes() == BYTES


def test_files_of_one_name_in_two_folders_are_two_files(tmp_path):
    own = data_set()
    assert own.place(tmp_path, "a/q.txt") != own.place(tmp_path, "b/q.txt")
