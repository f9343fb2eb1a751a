"""Long evidence goes on in its own folder only: results of other settings are never mixed."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from evidence.fuzz.campaign import campaign as fuzz
from evidence.kills.campaign import campaign as kills
from evidence.soak.campaign import soak
from hil.errors import SETTINGS, same_settings
from hil.world.scenario import ScenarioError

CAMPAIGNS: dict[str, Callable[[Path], Iterator[object]]] = {
    "soak": lambda folder: iter([soak(0.05, 50.0, 125, 2, folder)]),
    "kills": lambda folder: kills(1, folder, 2),
    "fuzz": lambda folder: fuzz(1, folder, 2),
}


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_campaign_refuses_the_folder_of_another_seed(tmp_path: Path, name: str) -> None:
    same_settings(tmp_path, {"seed": 1})
    with pytest.raises(ScenarioError, match="results of other settings; choose another --out"):
        next(CAMPAIGNS[name](tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == [SETTINGS]


def test_the_same_settings_go_on(tmp_path: Path) -> None:
    for _ in range(2):
        same_settings(tmp_path / "new", {"seed": 1, "rates_hz": (50.0, 125)})
