"""One short motion in virtual time for every test of the commands that read a recording."""

from pathlib import Path

import pytest

from hil.run.bench import prepare, run_virtual
from tests.support.short_cases import NoMeter, short


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a short motion in virtual time: its configuration and recording."""
    folder = tmp_path_factory.mktemp("flown")
    run_virtual(prepare(short(folder, hurry=2.0), 1, folder), NoMeter(), record=True)
    return folder
