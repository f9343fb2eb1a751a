"""What a daemon starts runs the daemon's own modules, wherever the operator stands."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fsw.exchange.tied import module_command

ROOT = str(Path(__file__).parents[4])


@pytest.fixture
def elsewhere(tmp_path, monkeypatch) -> Path:
    """A process of an installed command: its own folder is no place of modules."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [ROOT, *(p for p in sys.path if p)])
    return tmp_path


def run(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*command, "--version"],
        env=os.environ | {"PYTHONPATH": ROOT},
        capture_output=True,
        text=True,
        check=False,
    )


def test_files_of_the_current_folder_are_no_modules(elsewhere):
    for name in ("json", "signal", "struct", "argparse", "fsw"):
        (elsewhere / f"{name}.py").write_text("raise SystemExit('not the one that was meant')")
    done = run(module_command("fsw"))
    assert done.stdout.startswith("fsw "), done.stderr


def test_a_process_that_finds_its_own_modules_there_lets_the_others_find_them(elsewhere):
    sys.path.insert(0, str(elsewhere))
    (elsewhere / "one_of_ours.py").write_text("print('ours')")
    assert run(module_command("one_of_ours")).stdout == "ours\n"


def test_a_current_folder_that_was_removed_is_no_fault(elsewhere):
    elsewhere.rmdir()
    assert run(module_command("fsw")).stdout.startswith("fsw ")
