"""The version of the code that made a result, and seeds that nobody could choose."""

import subprocess
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

from hil.world.scenario import ScenarioError

FIRST_FRESH = 1_000_000  # fresh seeds are above the seeds of development
DEVELOPMENT = 1000  # seeds of development are below it


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


def draw(seed: int | None) -> str:
    """Return what fixes everything random in a study: the commit's hash, or a seed that is given.

    Raises
    ------
    ScenarioError if the code has no commit of its own, or the seed is not below DEVELOPMENT.
    """
    if seed is not None and seed >= DEVELOPMENT:
        raise ScenarioError(f"--seed {seed}: a seed of development is below {DEVELOPMENT}")
    own = commit() if seed is None else str(seed)
    if own == "unknown" or own.endswith("+"):
        raise ScenarioError(f"fresh seeds follow from a commit; this code is {own}; or use --seed")
    return own


def fresh_seed(*words: object) -> int:
    """Return a seed above those of development; the words, a draw among them, fix it."""
    text = " ".join(map(str, words)).encode()
    return FIRST_FRESH + int.from_bytes(sha256(text).digest()[:4], "big")


def seed_or_fresh(seed: int | None, study: str) -> int:
    """Return the given seed, or else one that the commit fixes. Raises ScenarioError as `draw`."""
    return fresh_seed(draw(None), study) if seed is None else seed
