"""One engine: every module of the estimators is used by a command or by the worker."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[4]
ENTRIES = (
    "fsw.estimation.process",
    "offline.identify",
    "offline.replay",
    "fsw.service.worker",
)


PACKAGES = ("fsw", "planner", "offline")


def modules() -> dict[str, Path]:
    """Return every module of the flight software, the planner and the offline tools by name."""
    found = {}
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(path: Path, known: dict[str, Path]) -> set[str]:
    """Return the modules of these packages that a file imports, at its top or within a function."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    parents = {name.rpartition(".")[0] for name in names}  # imported with what they hold
    return (names | parents) & set(known)


def closure(entries: tuple[str, ...]) -> set[str]:
    """Return the modules that these entries import, directly or not."""
    known, reached, waiting = modules(), set[str](), list(entries)
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            waiting += imported(known[name], known)
    return reached


def test_every_estimator_module_is_reached_from_a_command_or_the_worker() -> None:
    own = {name for name in modules() if name.startswith("fsw.estimators.")}
    assert len(own) > 20
    assert own - closure(ENTRIES) == set()


def test_nothing_of_the_flight_software_needs_a_compiler() -> None:
    """A start that waits for numba's compiler is no start of a flight program."""
    for path in modules().values():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
        names += [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
        assert not any(name.split(".")[0] == "numba" for name in names), path
