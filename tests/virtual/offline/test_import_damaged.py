"""`fsw import` of damaged files: every reader says one line, exits with 2, and writes nothing.

Every file is damaged by rules (cut, bytes turned, parts doubled, lines of 200,000 characters) with
seeds, and by hypothesis. What happens to be readable still is read; then it is said what was lost.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fsw.errors import ConfigError
from offline.can_logs.reading import read_can_log
from offline.importing.bags import bag_columns
from offline.importing.captures import serial_capture
from offline.importing.csv_file import csv_columns
from offline.importing.mapping import read_mapping
from offline.importing.tables import Table
from tests.support.estimator_cases import make_config
from tests.support.import_cases import Import, importing, write_log  # noqa: F401
from tests.support.joint_bags import ROWS, whole, write

SEEDS = 40
ROOM = 400  # characters of a path, beside a message that is cut
COLUMNS = ("t", "q_j1", "q_j2", "tau_j1", "tau_j2")


def table(folder: Path) -> Path:
    rows = ["t,q_j1,q_j2,tau_j1,tau_j2"]
    rows += [f"{k / 30},{0.1 * np.sin(k)},0.{k},{k % 7},{k % 5}" for k in range(300)]
    (folder / "a.csv").write_text("\n".join(rows) + "\n")
    return folder / "a.csv"


def archive(folder: Path) -> Path:
    np.savez_compressed(folder / "a.npz", **{name: np.arange(300.0) for name in COLUMNS})
    return folder / "a.npz"


def bag(folder: Path) -> Path:
    write(folder / "bag", map(whole, range(ROWS)))
    return next((folder / "bag").glob("*.mcap"))


def serial_rows(folder: Path) -> Path:
    rows = [f"{1000 + k / 500:.6f},{'a5' * 38}" for k in range(300)]
    (folder / "imu.csv").write_text("\n".join(["stamp_s,hex", *rows]) + "\n")
    return folder / "imu.csv"


def serial_json(folder: Path) -> Path:
    rows = [f'{{"stamp_s": {1000 + k / 500:.6f}, "hex": "{"a5" * 38}"}}' for k in range(300)]
    (folder / "imu.jsonl").write_text("\n".join(rows) + "\n")
    return folder / "imu.jsonl"


def log(suffix: str) -> Callable[[Path], Path]:
    return lambda folder: write_log(folder / f"a{suffix}")


def screen(folder: Path) -> Path:
    rows = [
        f" (17600000{k // 100:02d}.{k % 100:02d}0000)  can0  191   [2]  0A FF" for k in range(300)
    ]
    (folder / "a.log").write_text("\n".join(rows) + "\n")
    return folder / "a.log"


def busmaster(folder: Path) -> Path:
    head = "***BUSMASTER Ver 3.2.2***\n***START DATE AND TIME 9:10:2025 8:53:30:42***\n***HEX***\n"
    rows = [f"08:53:{k // 10:02d}:{k % 10}000 Rx 1 0x191 s 2 0A FF\n" for k in range(300)]
    (folder / "a.log").write_text(head + "***SYSTEM MODE***\n" + "".join(rows))
    return folder / "a.log"


def mapping(folder: Path) -> Path:
    joints = {
        "time": {"column": "t", "unit": "s"},
        "position": {"columns": "q_{}", "unit": "rad"},
        "torque": {"columns": "tau_{}", "unit": "N m"},
    }
    (folder / "map.yaml").write_text(yaml.safe_dump({"joints": joints}))
    return folder / "map.yaml"


def whole_table(path: Path) -> None:
    own = Table(path)
    for name in COLUMNS:
        own.column(name)


def serial(path: Path) -> None:
    serial_capture(make_config(), "imu", path, 0)


READERS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], object]]] = {
    "csv": (table, whole_table),
    "npz": (archive, whole_table),
    "bag": (bag, bag_columns),
    "serial csv": (serial_rows, serial),
    "serial json": (serial_json, serial),
    "candump": (log(".log"), read_can_log),
    "asc": (log(".asc"), read_can_log),
    "trc": (log(".trc"), read_can_log),
    "blf": (log(".blf"), read_can_log),
    "can csv": (log(".csv"), read_can_log),
    "screen": (screen, read_can_log),
    "busmaster": (busmaster, read_can_log),
    "mapping": (mapping, read_mapping),
}


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a file damaged in one of six ways."""
    a, b = sorted(rng.integers(0, len(data) + 1, 2).tolist())
    way = rng.integers(6)
    if way == 0:
        return data[:b]
    if way == 1:
        return data[:a] + data[b:]
    if way == 2:
        return data[:a] + rng.bytes(int(rng.integers(1, 200))) + data[a:]
    if way == 3:
        return data[:b] + data[a:]
    if way == 4:
        return data[:a] + rng.choice([b"x", b'"', b"1", b"["]) * 200_000 + data[a:]
    turned = np.frombuffer(data, np.uint8).copy()
    turned[rng.integers(0, len(data), int(rng.integers(1, 20)))] = rng.integers(0, 256)
    return turned.tobytes()


def holds(read: Callable[[Path], object], path: Path) -> bool:
    """Read a file; return whether it was refused, in one short line or a line for each key."""
    try:
        read(path)
    except ConfigError as error:
        lines = str(error).splitlines()
        assert all(str(path) in line and len(line) < ROOM + len(str(path)) * 2 for line in lines)
        return True
    return False


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused_in_words(name, tmp_path):
    make, read = READERS[name]
    path = make(tmp_path)
    data = path.read_bytes()
    assert not holds(read, path)
    refused = 0
    for seed in range(SEEDS):
        path.write_bytes(damaged(data, np.random.default_rng(seed)))
        refused += holds(read, path)
    assert refused > 0


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("name", READERS)
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(head=st.integers(0, 400), junk=st.binary(max_size=300))
def test_any_bytes_below_any_part_of_a_file_never_raise(name, tmp_path, head, junk):
    make, read = READERS[name]
    folder = tmp_path / "made"
    if not folder.exists():
        folder.mkdir()
        make(folder)
        whole_file = make(folder) if name != "bag" else next((folder / "bag").glob("*.mcap"))
        (tmp_path / "data").write_bytes(whole_file.read_bytes())
        (tmp_path / "name").write_text(whole_file.name)
    path = tmp_path / (tmp_path / "name").read_text()
    path.write_bytes((tmp_path / "data").read_bytes()[:head] + junk)
    holds(read, path)


@given(text=st.text(alphabet='0123456789.,;:-+eE"#\t anx\n', max_size=200))
@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_any_table_is_read_or_refused(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    holds(csv_columns, path)


@pytest.mark.parametrize("data", [b"", b"\n", b"\x00" * 300, b"\xff" * 300, b"a" * 200_000 + b"\n"])
@pytest.mark.parametrize("name", ["a.csv", "a.npz", "a.mcap", "a.db3", "a.bag", "a.yaml"])
def test_the_command_says_one_line(importing, tmp_path, name, data):  # noqa: F811
    arm: Import = importing(sampled=True)
    (tmp_path / name).write_bytes(data)
    mapped = yaml.safe_load(mapping(tmp_path).read_text())
    assert arm.table(tmp_path / name, mapped) == 2
    assert arm.is_refused(name)
