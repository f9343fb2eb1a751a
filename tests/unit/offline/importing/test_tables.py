"""What is plainly no table and no bag is said in words."""

import pickle
import re
from pathlib import Path

import numpy as np
import pytest

from fsw.errors import ConfigError
from offline.importing.tables import Table

WRONG = {
    "empty.yaml": ".yaml is not supported; FILE: a table .csv or .npz, a bag's folder or its .mcap",
    "README": "README is not supported; FILE: a table",
    "folder/": "the folder has no metadata.yaml",
    "missing": "no such file or folder",
}


@pytest.mark.parametrize("name", WRONG)
def test_the_fault_of_a_file_is_in_words(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if name.endswith("/"):
        path.mkdir()
    elif name != "missing":
        path.write_text("")
    words = f"{path}: cannot be read as a ROS 2 bag: {WRONG[name]}"
    with pytest.raises(ConfigError, match=re.escape(words)) as said:
        Table(path)
    assert "Error" not in str(said.value)


def archive(path: Path, **arrays: object) -> Path:
    np.savez(path, **arrays)
    return path


def test_objects_in_an_archive_do_not_hide_its_numbers(tmp_path: Path) -> None:
    mixed = {"t": np.arange(3.0), "meta": np.array([{"a": 1}]), "q": np.array([1.0, None, 2.0])}
    table = Table(archive(tmp_path / "a.npz", **mixed))
    assert table.names == ["t"]
    assert table.column("t")[0].shape == (3, 1)
    with pytest.raises(ConfigError, match=r"'q': holds Python objects; save numbers"):
        table.column("q")


@pytest.mark.parametrize("data", [b"\x93NUMPY\x01\x00", pickle.dumps({"t": 1}), b"PK\x03\x04"])
def test_what_is_no_archive_says_how_to_write_one(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(ConfigError, match=r"it is not an archive, or cut off; .*np\.savez") as said:
        Table(tmp_path / "a.npz")
    assert "pickle" not in str(said.value)


@pytest.mark.parametrize("name", ["a.npz", "folder.npz"])
def test_an_archive_that_cannot_be_opened_says_why(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.npz").mkdir()
    words = {"a.npz": "No such file or directory", "folder.npz": "Is a directory"}[name]
    with pytest.raises(ConfigError, match=re.escape(f"{name}: cannot be read: {words}")):
        Table(tmp_path / name)


@pytest.mark.parametrize("values", [np.zeros(0), np.zeros((0, 3)), np.zeros((3, 0))])
def test_an_empty_array_is_a_column_without_rows_or_width(tmp_path: Path, values) -> None:
    table = Table(archive(tmp_path / "a.npz", q=values))
    assert table.column("q")[0].shape == (*values.shape, 1)[:2]
    assert table.width("q") == (*values.shape, 1)[1]


def test_a_single_number_is_no_column(tmp_path: Path) -> None:
    table = Table(archive(tmp_path / "a.npz", t=0.02))
    assert table.width("t") == 0
    with pytest.raises(ConfigError, match="must be numbers, a row a sample"):
        table.column("t")


def test_dates_have_no_unit_of_numbers(tmp_path: Path) -> None:
    dates = np.datetime64("2026-01-01T00:00:00", "ns") + np.arange(3)
    table = Table(archive(tmp_path / "a.npz", t=dates))
    assert table.column("t", "iso")[0].shape == (3, 1)
    with pytest.raises(ConfigError, match="'t' holds dates; its unit must be iso"):
        table.column("t", "ns")


@pytest.mark.parametrize(
    ("name", "cure"),
    [("a.mcap", "recover what is there: mcap recover"), ("a.bag", "rosbag reindex")],
)
def test_a_cut_bag_says_how_to_recover_it(tmp_path: Path, name: str, cure: str) -> None:
    heads = {"a.mcap": b"\x89MCAP0\r\n" + bytes(64), "a.bag": b"#ROSBAG V2.0\n" + bytes(64)}
    (tmp_path / name).write_bytes(heads[name])
    with pytest.raises(ConfigError, match=f"{name}: cannot be read as a ROS .* bag: .*{cure}"):
        Table(tmp_path / name)
