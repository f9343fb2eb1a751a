"""The cure for a package that an installation lacks: the extra of this project that brings it."""

import re
from importlib.metadata import PackageNotFoundError, requires

PROJECT = "inertia-daemon"
_OWN = ("fsw", "planner", "offline", "hil", "evidence", "ground", "file_delivery")
_EXTRA = re.compile(r"(?P<package>[\w.-]+).*;.*extra == ['\"](?P<extra>[\w-]+)['\"]")
_IMPORTED_AS = {"pyerfa": "erfa", "yamcs_pymdb": "yamcs"}  # packages whose module has another name


def cure(error: ModuleNotFoundError, program: str) -> str:
    """Return what a command of `program` needs that could not import a package.

    Raises
    ------
    ModuleNotFoundError, the error itself, if the module is one of this project.
    """
    module = str(error.name)
    if module.partition(".")[0] in _OWN:
        raise error
    return needs("this command", module, program)


def needs(user: str, module: str, preferred: str = "") -> str:
    """Return a line that says what `user` (a command or file) needs and how to install it.

    Parameters
    ----------
    module : the module that could not be imported, such as `matplotlib.figure`
    preferred : the extra to name if it brings the module
    """
    top = module.partition(".")[0]
    extras = _extras_of(top)
    extra = preferred if preferred in extras else next(iter(extras), "")
    return f"{user} needs {top}: pip install '{PROJECT}{f'[{extra}]' * bool(extra)}'"


def _extras_of(module: str) -> list[str]:
    """Return the extras that bring a module, in the order of the project's metadata."""
    try:
        lines = requires(PROJECT) or []
    except PackageNotFoundError:  # run from a copy of the source
        lines = []
    found = [match for line in lines if (match := _EXTRA.match(line))]
    names = [(m["package"].lower().replace("-", "_"), m["extra"]) for m in found]
    return [extra for name, extra in names if _IMPORTED_AS.get(name, name) == module.lower()]
