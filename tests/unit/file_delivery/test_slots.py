"""A document in two copies is old or new after every crash, and needs no free space."""

import errno
import os
import random

import pytest

from file_delivery.slots import SlotError, SlotFile
from tests.support.small_disk import fill, small_disk, use_up_inodes


@pytest.fixture
def path(tmp_path):
    return tmp_path / "below" / "document"


def test_what_was_written_is_read_again(path):
    for document in ({"a": 1}, [1, "two", None], 1 << 96):
        SlotFile(path).write(document)
        assert SlotFile(path).read() == document


def test_the_file_is_closed_to_others_and_keeps_its_size_and_its_inode(path):
    file = SlotFile(path)
    file.write(0)
    before = path.stat()
    for number in range(20):
        file.write(number)
    after = path.stat()
    assert (after.st_ino, after.st_size) == (before.st_ino, before.st_size)
    assert after.st_mode & 0o777 == 0o600
    assert after.st_blocks * 512 >= after.st_size, "not all of it has blocks"


@pytest.mark.parametrize("spoil", [fill, use_up_inodes])
def test_a_full_disk_prevents_no_write(tmp_path, spoil):
    with small_disk(tmp_path / "disk", 1 << 20, 50) as disk:
        file = SlotFile(disk / "document")
        file.write(0)
        spoil(disk)
        with pytest.raises(OSError, match="No space left"):
            (disk / "other").write_bytes(b"1")
        for number in range(1, 50):
            file.write(number)
            assert SlotFile(disk / "document").read() == number


def test_a_write_that_is_torn_anywhere_leaves_the_old_document(path, monkeypatch):
    real = os.pwrite
    for number in range(1, 200):
        SlotFile(path).write(number)
        rng = random.Random(number)

        def torn(descriptor, data, offset, rng=rng):
            real(descriptor, data[: rng.randrange(200)], offset)
            raise OSError(errno.EIO, "power cut")

        with monkeypatch.context() as broken:
            broken.setattr(os, "pwrite", torn)
            with pytest.raises(OSError, match="power cut"):
                SlotFile(path).write(-number)
        # of a crash in the middle nothing but the untouched copy may be needed
        assert SlotFile(path).read() in (number, -number)


def test_the_first_copy_alone_counts_also_for_a_writer_that_has_not_read(path, monkeypatch):
    real = os.pwrite
    for number in range(1, 9):
        calls = []

        def once(descriptor, data, offset, calls=calls):
            calls.append(offset)
            if len(calls) > 1:
                raise OSError(errno.EIO, "the second copy cannot be written")
            return real(descriptor, data, offset)

        with monkeypatch.context() as broken:
            broken.setattr(os, "pwrite", once)
            SlotFile(path).write(number)
        assert SlotFile(path).read() == number


@pytest.mark.parametrize("place", [10, 4096 + 10])
def test_one_copy_that_decays_loses_nothing(path, place):
    for number in (1, 2, 3):
        SlotFile(path).write(number)
    data = bytearray(path.read_bytes())
    data[place] ^= 0x40
    path.write_bytes(data)
    assert SlotFile(path).read() == 3


def test_two_damaged_copies_are_an_error(path):
    SlotFile(path).write({"floor": 7})
    path.write_bytes(path.read_bytes().replace(b"7", b"6"))
    with pytest.raises(SlotError, match="CRC"):
        SlotFile(path).read()


def test_a_document_that_outgrows_its_room_gets_a_larger_file(path):
    file = SlotFile(path)
    for count in (10, 5000, 50_000):
        file.write("x" * count)
        assert SlotFile(path).read() == "x" * count


def test_a_removed_file_is_made_again_with_its_folder(path):
    file = SlotFile(path)
    file.write(1)
    path.unlink()
    path.parent.rmdir()
    file.write(2)
    assert SlotFile(path).read() == 2
