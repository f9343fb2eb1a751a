import pytest


@pytest.fixture
def assets(tmp_path):
    """A folder that looks like Open MCT's."""
    folder = tmp_path / "openmct"
    folder.mkdir()
    (folder / "openmct.js").write_text("// Open MCT")
    return folder
