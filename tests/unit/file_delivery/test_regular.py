"""Nobody waits for, or reads without end, what lies in a file's place."""

import os

import pytest

from file_delivery.durable import replace_file
from file_delivery.regular import open_regular, read_regular
from file_delivery.slots import SlotFile
from tests.support.awkward_files import PLANTS, within


@pytest.mark.parametrize("kind", PLANTS)
def test_what_is_no_regular_file_is_refused_at_once(tmp_path, kind):
    path = tmp_path / "file"
    PLANTS[kind](path)
    with within(5.0), pytest.raises(OSError, match=r"."):
        read_regular(path)


def test_a_pipe_is_not_written_even_while_somebody_reads_it(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    with within(5.0), pytest.raises(OSError, match="not a regular file"):
        open_regular(path, "wb")
    os.close(reader)


def test_a_pipe_beside_a_replaced_file_costs_one_replacement(tmp_path):
    path = tmp_path / "status"
    os.mkfifo(tmp_path / "status.new")
    with within(5.0), pytest.raises(OSError, match=r"."):
        replace_file(path, "1")
    replace_file(path, "2")
    assert read_regular(path) == b"2"


def test_a_pipe_in_the_place_of_numbers_is_replaced(tmp_path):
    file = SlotFile(tmp_path / "numbers")
    file.write({"a": 1})
    file.path.unlink()
    os.mkfifo(file.path)
    with within(5.0):
        file.write({"a": 2})
        assert file.read() == {"a": 2}


def test_a_file_of_the_greatest_size_is_read_and_a_greater_one_is_not(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_regular(path, 5) == b"12345"
    with pytest.raises(OSError, match="too large"):
        read_regular(path, 4)
