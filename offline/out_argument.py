"""`--out` and other options that name a new file: no file is overwritten without `--force`."""

import argparse
from pathlib import Path

from fsw.errors import ConfigError


def out_argument(
    parser: argparse.ArgumentParser, metavar: str, words: str, flag: str = "--out"
) -> None:
    """Add the option `flag` for an output, and `--force`; `main` refuses an existing file."""
    parser.add_argument(flag, type=Path, metavar=metavar, help=words)
    others = parser.get_default("new")
    if others is None:
        parser.add_argument("--force", action="store_true", help="overwrite what exists")
    # `main` checks these options first
    parser.set_defaults(new=(*(others or ()), flag.removeprefix("--")))


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


def refuse_no_folder(*paths: Path | None) -> None:
    """Raise ConfigError for a path given twice or without folder, before work that takes long."""
    given = [path for path in paths if path is not None]
    for path in given:
        if not path.absolute().parent.is_dir():
            raise ConfigError(f"{path}: the folder {path.parent} is missing; create it first")
        if given.count(path) > 1:
            raise ConfigError(f"{path}: named by two options; choose another name")


def write_result(out: Path, text: str) -> None:
    """Write a file that is complete or not there.

    Raises
    ------
    ConfigError when the file cannot be written; an unfinished file is removed.
    """
    unfinished = out.with_name(f"{out.name}.unfinished")
    try:
        unfinished.write_text(f"{text}\n", encoding="utf-8")
        unfinished.replace(out)
    except OSError as error:
        unfinished.unlink(missing_ok=True)
        raise ConfigError(f"--out: {out} cannot be written: {error.strerror}") from error
