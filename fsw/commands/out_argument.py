"""`--out` and other options that name a new file: no file is overwritten without `--force`."""

import argparse
from pathlib import Path

from fsw.errors import ConfigError


def out_argument(
    parser: argparse.ArgumentParser, metavar: str, words: str, flag: str = "--out"
) -> None:
    """Add the option `flag` for the output, and `--force`; `main` refuses an existing file."""
    parser.add_argument(flag, type=Path, metavar=metavar, help=words)
    parser.add_argument("--force", action="store_true", help=f"overwrite {flag}")
    parser.set_defaults(new=flag.removeprefix("--"))  # `main` checks this option first


def refuse_existing(arguments: argparse.Namespace, key: str = "out") -> None:
    """Refuse an existing output, unless it is an empty folder or `--force` is given.

    Raises
    ------
    ConfigError that names option, path and remedy; also if the output is a file the command reads.
    """
    path: Path | None = getattr(arguments, key)
    if path is None or not path.exists():
        return
    given = {name: value for name, value in vars(arguments).items() if name != key}
    if any(isinstance(own, Path) and own.exists() and own.samefile(path) for own in given.values()):
        raise ConfigError(f"--{key}: {path} is read by this command; choose another name")
    if arguments.force:
        return
    if not path.is_dir() or any(path.iterdir()):
        raise ConfigError(f"--{key}: {path} exists; --force overwrites it")
