"""Errors that end the bench with one clear message."""

from __future__ import annotations

import sys
from collections.abc import Callable


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
