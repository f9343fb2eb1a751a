"""A command that needs a package which is not installed ends with one line and the cure."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from file_delivery.extras import needs

BLOCKED = """
import sys
program, modules, *arguments = sys.argv[1:]
sys.modules.update(dict.fromkeys(modules.split(",")))
main = __import__(f"{program}.__main__", fromlist=["main"]).main
sys.exit(main(arguments))
"""
ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def ended(program: str, modules: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", BLOCKED, program, modules, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.parametrize(
    ("program", "modules", "arguments", "missing"),
    [
        ("hil", "rich", ["run", "target_leo", "--fast"], "rich"),
        ("hil", "rich", ["seeds", "target_leo"], "rich"),
        ("hil", "mujoco", ["run", "target_leo", "--fast", "--json"], "mujoco"),
        ("ground", "space_packet_parser,aiohttp", ["tc", "PING"], "space_packet_parser"),
        ("ground", "aiohttp", ["serve"], "aiohttp"),
    ],
    ids=str,
)
def test_a_missing_package_is_one_line_with_the_extra(
    program, modules, arguments, missing, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    done = ended(program, modules, *arguments)
    lines = [line for line in done.stderr.splitlines() if "preparing" not in line]
    cure = f"pip install 'inertia-daemon[{program}]'"
    assert lines == [f"{program}: this command needs {missing}: {cure}"]
    assert done.returncode == 2
    assert not list(tmp_path.rglob("*"))


@pytest.mark.parametrize("program", ["fsw", "hil", "ground"])
def test_help_needs_no_extra(program):
    modules = "rich,mujoco,numba,casadi,erfa,matplotlib,crccheck,space_packet_parser,aiohttp"
    assert ended(program, modules, "--help").returncode == 0


def test_every_extra_is_named_for_its_packages():
    modules = {"pyerfa": "erfa", "yamcs-pymdb": "yamcs"}
    extras = PROJECT["optional-dependencies"]
    for extra in ("excite", "ros2", "parquet", "view", "hil", "ground", "orekit"):
        for line in extras[extra]:
            package = line.split(">")[0].split("=")[0].split("[")[0]
            module = modules.get(package, package.replace("-", "_"))
            assert f"'inertia-daemon[{extra}]'" in needs("x", f"{module}.part", extra)


def test_a_package_of_no_extra_is_part_of_the_installation():
    assert needs("fsw run", "can", "hil") == "fsw run needs can: pip install 'inertia-daemon'"
