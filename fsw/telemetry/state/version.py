"""Version of the running software: package, commit (empty if unknown) and Python."""

import platform
from functools import cache
from importlib import metadata
from pathlib import Path

PACKAGE = "inertia-daemon"


@cache
def _running() -> dict[str, str]:
    try:
        version = metadata.version(PACKAGE)
    except metadata.PackageNotFoundError:
        version = "unpackaged"
    return {
        "package": f"{PACKAGE} {version}",
        "commit": commit(Path(__file__).parents[3]),
        "python": platform.python_version(),
    }


def version_values() -> dict[str, str]:
    """Return package with version, commit and Python version as they were at the first call."""
    return dict(_running())


def commit(top: Path) -> str:
    """Return the commit checked out in the folder `top`; empty outside a checkout."""
    git = top / ".git"
    try:
        if git.is_file():  # a linked work tree
            git = Path(git.read_text().removeprefix("gitdir:").strip())
        head = (git / "HEAD").read_text().strip()
        if not head.startswith("ref: "):
            return head
        name = head.removeprefix("ref: ")
        common = (
            git / (git / "commondir").read_text().strip() if (git / "commondir").exists() else git
        )
        loose = common / name
        if loose.exists():
            return loose.read_text().strip()
        lines = (common / "packed-refs").read_text().splitlines()
    except OSError:
        return ""
    return next((line.split()[0] for line in lines if line.endswith(f" {name}")), "")
