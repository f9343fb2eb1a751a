"""The version of the code that made a result."""

import subprocess
from functools import lru_cache
from pathlib import Path


@lru_cache(maxsize=1)
def commit() -> str:
    """Return this code's commit, with "+" if files differ from it; "unknown" without git."""
    here = Path(__file__).resolve().parent
    try:
        ran = subprocess.run(
            ("git", "-C", str(here), "describe", "--always", "--dirty=+", "--exclude=*"),
            capture_output=True,
            text=True,
            check=False,
            timeout=30.0,
        )
    except OSError:
        return "unknown"
    return ran.stdout.strip() or "unknown"
