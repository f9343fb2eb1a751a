"""Captures of serial lines: stamps that a recording cannot hold, and damaged files."""

from pathlib import Path

import numpy as np
import pytest

from fsw.config import load
from fsw.errors import ConfigError
from offline.importing import _refuse_gaps
from offline.importing.captures import Channel, serial_capture
from offline.importing.clock import refuse_disorder
from tests.support.driver_configs import unit_on_bus
from tests.support.estimator_cases import make_config


@pytest.mark.parametrize(
    ("t_ns", "words"),
    [
        ([-2_000_000_000, 0], "a stamp at -2 s; must be at least 0"),
        ([5, (1 << 63) - 1], r"a stamp at 9\.22337e\+09 s or later; must be below 9\.22337e\+09"),
    ],
)
def test_the_stamp_out_of_range_is_named(t_ns, words):
    with pytest.raises(ConfigError, match=words):
        refuse_disorder(Path("imu.csv"), np.array(t_ns, np.int64))


def imu_rows(step_s: float, size: int = 38) -> list[str]:
    """Return rows of one datagram each, at the unit's rate times 0.002 s / `step_s`."""
    return [f"{1000.0 + k * step_s:.6f},{'a5' * size}" for k in range(500)]


def write(path: Path, rows: list[str]) -> Path:
    path.write_text("\n".join(["stamp_s,hex", *rows]) + "\n")
    return path


def test_stamps_at_the_declared_rate_are_accepted_and_pauses_do_not_count(tmp_path):
    config = make_config()
    period_s = 1.0 / config.imu.rate_hz
    rows = imu_rows(period_s)
    rows += [f"{float(row.split(',')[0]) + 600.0:.6f},{row.split(',')[1]}" for row in rows]
    channel = serial_capture(config, "imu", write(tmp_path / "imu.csv", rows), 0)
    assert channel.text.startswith("38000 bytes in 60")


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (imu_rows(0.0), "bytes in no time for a sample at imu.rate_hz .*: are the stamps diff"),
        (imu_rows(1e-6), "must be 8 to 1000: are the stamps differences"),
        (imu_rows(0.9), "are the stamps in another unit than seconds"),
    ],
)
def test_stamps_that_contradict_the_declared_rate_are_refused(tmp_path, rows, words):
    with pytest.raises(ConfigError, match=words):
        serial_capture(make_config(), "imu", write(tmp_path / "imu.csv", rows), 0)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("imu.csv", "stamp_s,hex\n1e999999999,a5\n", "must be seconds and hexadecimal bytes"),
        ("imu.csv", "stamp_s,hex\nNaN,a5\n", "must be seconds and hexadecimal bytes"),
        ("imu.csv", f"stamp_s,hex\n1,{'a' * 200_000}\n", "line 2: field larger than"),
        ("imu.csv", f"{'a' * 200_000},hex\n1,a5\n", "line 1: field larger than"),
        ("imu.jsonl", '{"stamp_s": ' + "[" * 100_000 + "\n", "line 1: not JSON"),
        ("imu.jsonl", '{"stamp_s": 1e999999999, "hex": "a5"}\n', "must be seconds"),
        ("imu.jsonl", '{"stamp_s": 1, "hex": 5}\n', "must be seconds and hexadecimal bytes"),
        ("imu.jsonl", '{"stamp_s": {}, "hex": "a5"}\n', "must be seconds and hexadecimal bytes"),
    ],
)
def test_a_damaged_row_is_named(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=words):
        serial_capture(make_config(), "imu", tmp_path / name, 0)


def test_a_unit_on_a_bus_of_which_no_log_is_given_is_named(arm):
    unit_on_bus(arm.data)
    source, t_ns = Path("joints.csv"), np.zeros(1, np.int64)
    joints = Channel(topic="/samples/joints", source=source, t_ns=t_ns, text="", write=str)
    with pytest.raises(ConfigError, match="imu, or map them"):
        _refuse_gaps(load(arm.write()), [joints])
