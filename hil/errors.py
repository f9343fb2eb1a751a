"""Errors that end the bench with one clear message."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

INTERRUPTED_EXIT = 130  # 128 + SIGINT


def explained(action: Callable[[], int], wrong_exit: int, failed_exit: int) -> int:
    """Run the action; an error that is somebody's to correct is one line and an exit code."""
    from fsw.errors import ConfigError, FswError
    from hil.live import LiveError
    from hil.scenario import ScenarioError

    try:
        return action()
    except (ConfigError, ScenarioError) as error:
        sys.stderr.write(f"hil: {error}\n")
        return wrong_exit
    except (FswError, LiveError) as error:
        sys.stderr.write(f"hil: {error}\n")
        return failed_exit
    except KeyboardInterrupt:
        sys.stderr.write("hil: interrupted; a command that resumes goes on with the same --out\n")
        return INTERRUPTED_EXIT


def make_folder(path: Path) -> None:
    """Make the folder of a command's results. Raises ScenarioError when that cannot be."""
    from hil.scenario import ScenarioError

    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScenarioError(f"--out {path}: {error.strerror}") from error
