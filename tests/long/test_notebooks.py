"""The notebooks of docs/notebooks: committed with their outputs, small, and they run."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[2] / "docs"
NAMES = ("own_robot", "compare_methods")  # the second reads the recording of the first
LARGEST_BYTES = 500_000
NUMBER = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?")


def cells(name: str, kind: str, where: Path = DOCS) -> list[dict[str, Any]]:
    notebook = json.loads((where / "notebooks" / f"{name}.ipynb").read_text(encoding="utf-8"))
    return [cell for cell in notebook["cells"] if cell["cell_type"] == kind]


def printed(cell: dict[str, Any]) -> str:
    """Return what a cell has printed, without its figures and the padding about them."""
    text = "".join("".join(output.get("text", "")) for output in cell["outputs"])
    return re.sub(r"\s+", " ", NUMBER.sub("#", text))


def test_every_notebook_is_in_this_test():
    assert sorted(NAMES) == sorted(p.stem for p in (DOCS / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_is_committed_as_it_ran_from_top_to_bottom(name):
    assert (DOCS / "notebooks" / f"{name}.ipynb").stat().st_size < LARGEST_BYTES
    code = cells(name, "code")
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell["outputs"]]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not any(output["output_type"] == "error" for output in outputs)
    assert str(DOCS.parent) not in json.dumps(outputs), "a path of somebody's machine"
    assert sum("assert " in "".join(cell["source"]) for cell in code) >= 2


@pytest.mark.parametrize("name", NAMES)
def test_the_words_of_a_notebook_are_spelled_right(name):
    words = "\n".join("".join(cell["source"]) for cell in cells(name, "markdown"))
    tool = Path(sys.executable).parent / "codespell"
    done = subprocess.run([tool, "-"], input=words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_the_notebooks_run_and_show_what_they_claim(tmp_path):
    """Their cells assert every claim; the words that they print are those committed."""
    for folder in ("notebooks", "inspector"):
        shutil.copytree(DOCS / folder, tmp_path / folder, ignore=shutil.ignore_patterns("runs"))
    for name in NAMES:
        done = subprocess.run(
            [sys.executable, "-m", "jupyter", "execute", "--inplace", f"{name}.ipynb"],
            cwd=tmp_path / "notebooks",
            env={**os.environ, "PYTHONPATH": str(DOCS.parent)},
            capture_output=True,
            text=True,
            timeout=240,
            check=False,
        )
        assert done.returncode == 0, done.stderr[-3000:]
        ran = cells(name, "code", tmp_path)
        assert [printed(cell) for cell in ran] == [printed(cell) for cell in cells(name, "code")]
