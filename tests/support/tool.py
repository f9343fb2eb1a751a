"""Ground tools in environments of their own, since each pins other versions."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest


def run_tool(python: Path, script: str, *words: object, timeout_s: float) -> dict[str, Any]:
    """Run a script in a tool's own environment; return the JSON of its last line."""
    if not python.exists():
        pytest.skip(f"needs {python.parents[1].name}: sh tests/setup --all")
    path = Path(__file__).with_name(script)
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [python, path, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
        env=clean,
    )
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout.splitlines()[-1]))
