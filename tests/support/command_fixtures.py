"""One short motion in virtual time for every test of the commands that read a recording."""

from pathlib import Path

import pytest

from fsw.checks import configuration
from fsw.config import Config
from fsw.estimators.model.problem import Problem
from hil.run.bench import prepare, run_virtual
from tests.support.short_cases import NoMeter, short

rehearse = configuration.rehearse
rehearsed: set[tuple[str, bytes]] = set()


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a short motion in virtual time: its configuration and recording."""
    folder = tmp_path_factory.mktemp("flown")
    run_virtual(prepare(short(folder, hurry=2.0), 1, folder), NoMeter(), record=True)
    return folder


@pytest.fixture(autouse=True)
def rehearsed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the dry update of equal configurations and robots once; every command makes it."""

    def once(config: Config, problem: Problem) -> None:
        key = config.model_dump_json(), config.resolve(config.robot.urdf).read_bytes()
        if key not in rehearsed:
            rehearse(config, problem)
            rehearsed.add(key)

    monkeypatch.setattr(configuration, "rehearse", once)
