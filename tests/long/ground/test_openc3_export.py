"""The COSMOS export in openc3 itself: everything loads, with hazards and limits."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fsw.telemetry.dictionary import DICTIONARY, Significance

pytest.importorskip("yamcs.pymdb", reason="needs yamcs-pymdb: pip install '.[ground]'")

from offline.exports import FOLDER
from offline.exports.single import single_commands

ROOT = Path(__file__).parents[3]
OPENC3 = Path(sys.prefix) / "openc3" / "bin" / "python"


@pytest.fixture(scope="module")
def cosmos() -> dict[str, Any]:
    """Return what openc3 has loaded of the COSMOS export."""
    if not OPENC3.exists():
        pytest.skip("needs openc3 in an environment of its own: sh tests/setup --all")
    script = ROOT / "tests" / "support" / "openc3_client.py"
    command = [OPENC3, script, ROOT / FOLDER / "cosmos"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout.splitlines()[-1]))


def test_openc3_loads_every_packet_and_command_without_a_warning(cosmos):
    assert cosmos["warnings"] == []
    assert set(cosmos["telemetry"]) == {packet.name.upper() for packet in DICTIONARY.packets}
    commands = {command.name.upper() for command in single_commands(DICTIONARY)}
    assert set(cosmos["commands"]) == commands


def test_openc3_asks_before_commands_that_cost_something(cosmos):
    assert set(cosmos["hazardous"]) == {
        command.name.upper()
        for command in single_commands(DICTIONARY)
        if command.telecommand.significance is not Significance.NORMAL
    }
    assert "RESTART" in cosmos["hazardous"]
    assert "PING" not in cosmos["hazardous"]


@pytest.mark.parametrize(
    ("value", "concern"),
    [(2.0, "NORMAL"), (2.1, "YELLOW"), (10.0, "YELLOW"), (10.1, "RED"), (0.0, "NORMAL")],
)
def test_openc3_has_the_limits_of_the_dictionary(cosmos, value, concern):
    _, yellow_low, yellow_high, red_high = cosmos["limits"]["HEALTH"]["SUMMARY_AGE_S"]
    age = next(item for item in DICTIONARY.packet("health").fields if item.name == "summary_age_s")
    assert age.limits.concern(value).name == concern
    assert (yellow_high, red_high) == (age.limits.yellow_high, age.limits.red_high)
    assert yellow_low < value


def test_a_whole_number_in_openc3_is_good_up_to_its_limit(cosmos):
    # COSMOS counts a value at its limit as outside already
    assert cosmos["limits"]["HEALTH"]["HEALTH_NOW"] == [-1.0, -1.0, 1.0, 2.0**32]
    free = cosmos["limits"]["RECORDER"]["DISK_FREE_BYTES"]
    assert free[:2] == [1e8 - 1, 1e9 - 1]
