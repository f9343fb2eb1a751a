"""Errors that end the bench with one clear message."""

import json
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

SETTINGS = "settings.json"  # file in a folder of results: the settings that made them
INTERRUPTED_EXIT = 130  # 128 + SIGINT


def explained(
    action: Callable[[], int], wrong_exit: int, failed_exit: int, out: Path | None = None
) -> int:
    """Run the action and return its exit code; print an expected error as one line.

    `out` is the folder of the command's results; if it holds settings, an interrupted command says
    that the same command continues from it.
    """
    from fsw.errors import ConfigError, FswError, in_words

    try:
        from hil.run.live import LiveError  # it and the next one may lack a package
        from hil.world.scenario import ScenarioError

        code = action()
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader of the output closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except ModuleNotFoundError as error:  # first: the classes below may be what is missing
        sys.stderr.write(f"hil: {in_words(error, 'hil')}\n")
        return wrong_exit
    except (FswError, ScenarioError, LiveError, OSError) as error:
        sys.stderr.write(f"hil: {in_words(error, 'hil')}\n")
        return wrong_exit if isinstance(error, ConfigError | ScenarioError) else failed_exit
    except KeyboardInterrupt:
        resumes = out is not None and (out / SETTINGS).exists()
        words = f"; the same command continues from {out}" * resumes
        sys.stderr.write(f"hil: interrupted{words}\n")
        return INTERRUPTED_EXIT


def same_settings(folder: Path, wanted: Mapping[str, Any]) -> None:
    """Write the settings of a folder's results, or check that the folder has the same settings.

    Raises
    ------
    ScenarioError if the folder cannot be made, or holds results of other settings.
    """
    from hil.world.scenario import ScenarioError

    make_folder(folder)
    path, text = folder / SETTINGS, json.dumps(wanted, indent=1)
    if not path.exists():
        path.write_text(text + "\n", encoding="utf-8")
    elif json.loads(path.read_text(encoding="utf-8")) != json.loads(text):
        raise ScenarioError(f"{path}: results of other settings; choose another --out")


def make_folder(path: Path) -> None:
    """Make the folder of a command's results. Raises ScenarioError if that fails."""
    from hil.world.scenario import ScenarioError

    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScenarioError(f"--out {path}: {error.strerror}") from error
