"""`hil schema KEY` explains the keys of a scenario, as `fsw schema` those of a configuration."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from fsw.errors import ConfigError
from hil.__main__ import main
from hil.scenario_keys import keys_of, sections

WORLD = Path(__file__).parents[3] / "docs" / "inspector" / "world.yaml"
OPEN = ("bodies", "flight.bus", "flight.estimator")  # names of the user's choice, keys of others


def names_in(value: object, prefix: str = "") -> Iterator[str]:
    if isinstance(value, dict) and prefix not in OPEN:
        for key, inner in value.items():
            yield from names_in(inner, f"{prefix}.{key}" if prefix else key)
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        yield from names_in(value[0], f"{prefix}[]")
    else:
        yield prefix


def test_every_key_of_a_world_is_explained():
    known = {key.name for keys in sections().values() for key in keys}
    used = set(names_in(yaml.safe_load(WORLD.read_text(encoding="utf-8"))))
    assert len(used) > 35
    assert used <= known


def test_a_part_prints_its_keys_with_values_and_defaults(capsys):
    assert main(["schema", "sensors.joints.nodes"]) == 0
    said = capsys.readouterr().out
    assert "sensors.joints.nodes[].sign: -1, 1; default 1" in said.splitlines()
    assert all(map(str.strip, said.splitlines())), "a key without a comment has one line"
    assert "sensors.imu" not in said
    assert main(["schema"]) == 0
    assert capsys.readouterr().out.count("\n") > 150


def test_an_unknown_part_is_one_line(capsys):
    with pytest.raises(
        ConfigError, match=r"sensors\.imo: must be a key; did you mean sensors\.imu"
    ):
        keys_of("sensors.imo")
    assert main(["schema", "sensors.imo"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_section_of_several_kinds_has_the_keys_of_each():
    found = [key.name for key in keys_of("trajectories.sudden")]
    assert found.count("trajectories.sudden.kind") == 3
    assert {"trajectories.sudden.at_s", "trajectories.sudden.period_s"} <= set(found)
