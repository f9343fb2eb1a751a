"""Figures of the source's structure: `python -m hil.evidence house`.

Imports are import-linter's graph (grimp), lazy ones included, those for type checkers left out. A
room is a file or folder directly below a package; an arrow is an import between two rooms; floors
are the rooms of the longest chain of arrows, rooms that import each other counted as one.
The hops of a value are counted by `python -m hil.evidence walks`, from a run.
"""

import json
import sys
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import grimp
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).parents[2]
PACKAGES = ("fsw", "hil", "ground", "file_delivery")
ENTRIES = (
    "fsw.__main__",
    "fsw.loop.estimation.process",
    "fsw.service.process",
    "fsw.service.worker",
)

Edges = set[tuple[str, str]]


@dataclass(frozen=True, slots=True, kw_only=True)
class House:
    """The figures."""

    entries: int  # files and folders at the top of fsw
    contract_layers: int  # of the import contract of fsw
    contract_names: int
    rooms: int  # of fsw
    floors: int
    arrows: int
    circles: list[list[str]]  # modules that import each other
    unreachable: list[str]  # modules of fsw.estimators that no entry point reaches
    lines: dict[str, int]  # of source, per package
    tests: int  # files
    mirrored: int  # test files that stand where the module of their name stands


def main(root: Path = ROOT) -> int:
    """Print the figures as JSON; return 0."""
    sys.stdout.write(json.dumps(asdict(count(root)), indent=1) + "\n")
    return 0


def count(root: Path) -> House:
    """Return the figures of a checkout; its packages must be importable from there."""
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True, cache_dir=None)
    edges = {
        (module, found)
        for module in graph.modules
        for found in graph.find_modules_directly_imported_by(module)
    }
    layers = contract(root / "pyproject.toml")
    fsw = {(room(a), room(b)) for a, b in edges if is_in("fsw", a) and is_in("fsw", b)}
    arrows = {(a, b) for a, b in fsw if a != b}
    reached = {name for entry in ENTRIES for name in closure(entry, edges)}
    estimators = {module for module in graph.modules if is_in("fsw.estimators", module)}
    tests = sorted((root / "tests").rglob("test_*.py"))
    return House(
        entries=len(entries(root / "fsw")),
        contract_layers=len(layers),
        contract_names=sum(len(names) for names in layers),
        rooms=len({room(module) for module in graph.modules if is_in("fsw", module)} - {"fsw"}),
        floors=floors(arrows),
        arrows=len(arrows),
        circles=circles(edges),
        unreachable=sorted(estimators - reached),
        lines={name: lines((root / name).rglob("*.py")) for name in PACKAGES},
        tests=len(tests),
        mirrored=sum(is_mirror(path.relative_to(root / "tests"), root) for path in tests),
    )


def entries(folder: Path) -> list[str]:
    """Return the files and folders of a package that a reader sees first."""
    hidden = {"__pycache__", "__init__.py"}
    return sorted(path.name for path in folder.iterdir() if path.name not in hidden)


def contract(path: Path) -> list[list[str]]:
    """Return the names of each layer in the import contract of fsw."""
    tools = tomllib.loads(path.read_text(encoding="utf-8"))["tool"]
    contracts: list[Mapping[str, list[str]]] = tools["importlinter"]["contracts"]
    (own,) = (c["layers"] for c in contracts if c.get("containers") == ["fsw"])
    return [[name.strip() for name in layer.split("|")] for layer in own]


def room(module: str) -> str:
    """Return the room of a module: its first two names."""
    return ".".join(module.split(".")[:2])


def is_in(package: str, module: str) -> bool:
    """Return whether a module is a package or below it."""
    return f"{module}.".startswith(f"{package}.")


def components(edges: Edges) -> dict[str, int]:
    """Return the number of each name's group; names that reach each other share one."""
    names = sorted({name for edge in edges for name in edge})
    place = {name: k for k, name in enumerate(names)}
    rows, columns = (np.array([place[edge[k]] for edge in edges], np.intp) for k in range(2))
    matrix = coo_array((np.ones(len(edges)), (rows, columns)), shape=(len(names), len(names)))
    _, labels = connected_components(matrix, directed=True, connection="strong")
    return dict(zip(names, map(int, labels), strict=True))


def circles(edges: Edges) -> list[list[str]]:
    """Return the groups of names that import each other."""
    groups: dict[int, list[str]] = {}
    for name, label in components(edges).items() if edges else ():
        groups.setdefault(label, []).append(name)
    return sorted(group for group in groups.values() if len(group) > 1)


def floors(arrows: Edges) -> int:
    """Return the length of the longest chain of groups."""
    group = components(arrows) if arrows else {}
    below: dict[int, set[int]] = {label: set() for label in group.values()}
    for a, b in arrows:
        if group[a] != group[b]:
            below[group[a]].add(group[b])
    heights: dict[int, int] = {}

    def height(label: int) -> int:
        if label not in heights:
            heights[label] = 1 + max(map(height, below[label]), default=0)
        return heights[label]

    return max(map(height, below), default=0)


def closure(entry: str, edges: Edges) -> set[str]:
    """Return the modules that a module imports, directly or not, with their packages."""
    imported: dict[str, set[str]] = {}
    for a, b in edges:
        imported.setdefault(a, set()).add(b)
    found, waiting = set[str](), [entry]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            package = name.rpartition(".")[0]
            waiting += [*imported.get(name, ()), *([package] if package else ())]
    return found


def lines(paths: Iterable[Path]) -> int:
    """Return the lines of some files."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


def is_mirror(path: Path, root: Path) -> bool:
    """Return whether LANE/PACKAGE/FOLDER/test_NAME.py mirrors PACKAGE/FOLDER/NAME."""
    place = root.joinpath(*path.parts[1:-1], path.stem.removeprefix("test_"))
    return place.with_suffix(".py").exists() or (place / "__init__.py").exists()
