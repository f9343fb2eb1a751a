"""What is plainly no table and no bag is said in words."""

import re
from pathlib import Path

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
