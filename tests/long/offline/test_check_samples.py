"""Mistakes in imported data, under gravity and in free float: `fsw check` names each one.

The words are those of docs/howto/when_wrong.md. Data that are right agree with their configuration.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from fsw.__main__ import main
from hil.run.bench import prepare
from tests.support.sampled_cases import Columns, sampled, sampled_config, write_csv
from tests.support.sampled_mistakes import IN_FREE_FLOAT, UNDER_GRAVITY, spoiled
from tests.support.short_cases import short
from tests.support.when_wrong import ROWS

WORDS = {mistake: words for mistake, _, words in ROWS}
PLACES = dict.fromkeys(UNDER_GRAVITY, "bench_target") | dict.fromkeys(IN_FREE_FLOAT, "target_leo")


@dataclass(frozen=True)
class Recorded:
    folder: Path
    joints: Columns
    imu: Columns
    config: dict[str, Any]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recorded]:
    found = {}
    for name in ("bench_target", "target_leo"):
        folder = tmp_path_factory.mktemp(name)
        setup = prepare(short(folder, hurry=2.0, name=name), 1, folder)
        path = sampled_config(setup)
        data = yaml.safe_load(path.read_text())
        data["robot"]["urdf"] = str(folder / data["robot"]["urdf"])
        found[name] = Recorded(folder, *sampled(setup, path, 1), data)
    return found


def checked(own: Recorded, change, folder: Path, capsys) -> tuple[int, list[str]]:
    joints, imu, mapping, config = spoiled(change, own.joints, own.imu, own.config)
    write_csv(folder / "joints.csv", joints)
    write_csv(folder / "imu.csv", imu)
    (folder / "map.yaml").write_text(yaml.safe_dump(mapping))
    path, out = folder / "robot.yaml", folder / "out.mcap"
    path.write_text(yaml.safe_dump(config))
    command = ["import", "--map", str(folder / "map.yaml"), "--config", str(path)]
    assert main([*command, "--out", str(out)]) == 0
    capsys.readouterr()
    code = main(["check", str(path), str(out)])
    return code, capsys.readouterr().out.splitlines()


@pytest.mark.parametrize("name", ["bench_target", "target_leo"])
def test_data_that_are_right_agree(recorded, name, tmp_path, capsys):
    code, lines = checked(recorded[name], lambda *_: None, tmp_path, capsys)
    assert (code, [line for line in lines if "WRONG" in line]) == (0, [])


@pytest.mark.parametrize("mistake", [*UNDER_GRAVITY, *IN_FREE_FLOAT])
def test_a_mistake_in_imported_data_is_named(recorded, mistake, tmp_path, capsys):
    change = (UNDER_GRAVITY | IN_FREE_FLOAT)[mistake]
    code, lines = checked(recorded[PLACES[mistake]], change, tmp_path, capsys)
    named = [line for line in lines if "WRONG" in line and WORDS[mistake] in line]
    assert (code, bool(named)) == (1, True), "\n".join(lines)
