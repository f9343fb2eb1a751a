"""The project's own rules: style, types, imports, spelling, and that CI runs the README."""

import subprocess
import sys
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest
import yaml

ROOT = Path(__file__).parents[1]
TOOLS = Path(sys.executable).parent
PACKAGES = ("evidence", "file_delivery", "fsw", "ground", "hil", "offline", "planner")

COMMANDS = {
    "ruff check": ["ruff", "check", "."],
    "ruff format": ["ruff", "format", "--check", "."],
    "mypy": ["mypy"],
    "lint-imports": ["lint-imports", "--no-cache"],
    "codespell": ["codespell"],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_tool_finds_nothing(name):
    program, *arguments = COMMANDS[name]
    done = subprocess.run(
        [TOOLS / program, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"


def test_a_commit_is_checked_by_the_same_tools():
    (repo,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    entries = {hook["name"]: hook["entry"] for hook in repo["hooks"]}
    assert entries == {name: f".venv/bin/{' '.join(words)}" for name, words in COMMANDS.items()}


def test_the_workflow_runs_what_ci_runs():
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text())
    assert {"run": ".ci/run"} in workflow["jobs"]["ci"]["steps"]


def block_below(heading: str) -> str:
    """Return the first code block below a heading of the README."""
    section = (ROOT / "README.md").read_text().split(f"\n{heading}\n", 1)[1]
    return section.split("```", 2)[1].partition("\n")[2]


def test_the_readme_installs_all_it_needs_and_runs_the_main_job():
    assert block_below("## Run") == "sh demo\n"
    script = (ROOT / "demo").read_text()
    assert "install -q -y --no-install-recommends python3-venv" in script
    assert "python3 -m venv .venv" in script
    assert ".venv/bin/pip install" in script
    assert "set -- target_leo\nexec .venv/bin/hil run" in script
    assert subprocess.run(["sh", "-n", ROOT / "demo"], check=False).returncode == 0


def test_the_readme_sets_up_and_runs_the_tests():
    assert block_below("## Test") == "sh tests/setup && .venv/bin/python -m pytest\n"
    assert subprocess.run(["sh", "-n", ROOT / "tests" / "setup"], check=False).returncode == 0


def test_every_command_is_installed():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for name in project["scripts"]:
        done = subprocess.run(
            [TOOLS / name, "--help"], capture_output=True, text=True, timeout=60, check=False
        )
        assert done.returncode == 0, done.stderr
        assert f"usage: {name}" in done.stdout


def test_every_file_of_the_packages_is_installed():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    patterns = settings["package-data"]["*"]
    left_out = [
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".py"
        if not any(path.match(pattern) for pattern in patterns)
    ]
    assert left_out == []


def test_no_module_imports_itself_by_a_detour():
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True, cache_dir=None)
    order = TopologicalSorter(
        {m: graph.find_modules_directly_imported_by(m) for m in graph.modules}
    )
    order.prepare()  # CycleError names the circle
