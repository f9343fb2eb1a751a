from pathlib import Path

import pytest

from file_delivery.entity import FileEntity


@pytest.fixture
def folder(tmp_path) -> Path:
    path = tmp_path / "files"
    path.mkdir()
    return path


@pytest.fixture
def entity(folder) -> FileEntity:
    return FileEntity(folder, max_file_bytes=1 << 20)
