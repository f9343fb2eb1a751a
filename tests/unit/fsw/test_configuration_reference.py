"""The keys of the configuration as they are explained: in words, in the schema, on the page."""

import importlib.util
import json
import re
from pathlib import Path

from pydantic import BaseModel

from fsw.__main__ import main
from fsw.checks.configuration import validate
from fsw.config import Config, load
from fsw.config.reference import json_schema, keys, keys_of, meanings
from fsw.config.text import model_in

DOCUMENT = Path(__file__).parents[3] / "docs" / "configuration.md"
SECTIONS = re.findall(r"^### (\w+)$", DOCUMENT.read_text(), re.MULTILINE)


def test_every_key_has_a_meaning():
    assert [key.name for key in keys() if len(key.meaning) < 4 or key.meaning.endswith(".")] == []


def test_the_page_has_a_section_for_each_of_the_file():
    assert list(Config.model_fields) == SECTIONS


def test_values_defaults_and_meaning_are_those_of_the_declaration():
    (lag,) = keys_of("estimator.lag_s")
    assert (lag.values, lag.default) == ("number >= 0, <= 10", "0.15")
    assert "slowest sensor" in lag.meaning
    rate, source = keys_of("buses.rate_hz")[0], keys_of("buses[].feed.source")[0]
    assert (rate.values, rate.default) == ("number > 0, <= 10000", "required")
    assert source.values == "integer >= 0, <= 4294967295"


def test_a_text_below_a_declaration_is_its_meaning_and_no_other_text_is():
    class Foreign(BaseModel):
        size_m: float = 1.0
        """not of this package"""

    assert meanings(Foreign) == {}
    assert set(meanings(model_in(Config.model_fields["imu"].annotation))) >= {"rate_hz", "driver"}


def test_the_schema_explains_keys_without_links_those_of_a_prismatic_joint_too():
    joint = json_schema()["$defs"]["JointConfig"]["properties"]
    assert "physically impossible" in joint["torque_limit_nm"]["description"]
    assert joint["force_limit_n"]["description"] == joint["torque_limit_nm"]["description"]
    assert "](" not in json.dumps(json_schema())


def test_the_command_prints_a_section_or_a_key_in_words(capsys):
    assert main(["schema", "imu.rate_hz"]) == 0
    assert capsys.readouterr().out.startswith("imu.rate_hz: number > 0")
    assert main(["schema", "joints"]) == 0
    assert capsys.readouterr().out.count("\njoints[].") == len(keys_of("joints")) - 1
    assert main(["schema", "jionts"]) == 2
    assert "jionts: must be one of robot, base" in capsys.readouterr().err


def test_the_site_has_the_table_of_each_section_at_its_end():
    spec = importlib.util.spec_from_file_location("generate", DOCUMENT.with_name("generate.py"))
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    page = generate.with_keys(DOCUMENT.read_text())
    assert page.count("\n| `") == len(list(keys()))
    assert page.index("### imu") < page.index("| `imu.rate_hz` |") < page.index("### star_tracker")
    shown = generate.with_keys("# a\n\n### unknown\n").splitlines()
    assert shown[:3] == ["# a", "", "### unknown"]


def test_the_worked_example_is_a_correct_configuration(arm):
    example = re.search(r"```yaml\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    assert example is not None
    arm.robot(6)
    arm.write()
    path = arm.folder / "example.yaml"
    path.write_text(example[1])
    problem, warnings = validate(load(path))
    assert problem.model.n == 6
    assert warnings == []
