"""Figures of the source's structure: `python -m hil.evidence house`.

Imports come from import-linter's graph (grimp). Lazy imports count, imports for type checkers do
not. A room is a file or folder directly below a package. An arrow is an import between two rooms.
Floors are the number of rooms in the longest chain of arrows; rooms that import each other count as
one. `python -m hil.evidence walks` counts the function calls of a value.
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
    """The figures of the structure; rooms, floors and arrows are defined in the module's head."""

    entries: int  # files and folders at the top of fsw
    contract_layers: int  # layers in the import contract of fsw
    contract_names: int  # names in all layers of the import contract of fsw
    rooms: int  # rooms of fsw
    floors: int  # floors of fsw
    arrows: int  # arrows between rooms of fsw
    circles: list[list[str]]  # groups of modules that import each other
    unreachable: list[str]  # modules of fsw.estimators that no entry point reaches
    lines: dict[str, int]  # lines of source by package
    tests: int  # test files
    mirrored: int  # test files whose path mirrors the path of a module


def main(root: Path = ROOT) -> int:
    """Print the figures as JSON; return 0."""
    sys.stdout.write(json.dumps(asdict(count(root)), indent=1) + "\n")
    return 0


def count(root: Path) -> House:
    """Return the figures of a checkout; Python must import the packages from this checkout."""
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
    """Return the sorted names of the files and folders directly in a package's folder."""
    hidden = {"__pycache__", "__init__.py"}
    return sorted(path.name for path in folder.iterdir() if path.name not in hidden)


def contract(path: Path) -> list[list[str]]:
    """Return the names of each layer in the import contract of fsw; `path` is pyproject.toml."""
    tools = tomllib.loads(path.read_text(encoding="utf-8"))["tool"]
    contracts: list[Mapping[str, list[str]]] = tools["importlinter"]["contracts"]
    (own,) = (c["layers"] for c in contracts if c.get("containers") == ["fsw"])
    return [[name.strip() for name in layer.split("|")] for layer in own]


def room(module: str) -> str:
    """Return the room of a module: its first two names."""
    return ".".join(module.split(".")[:2])


def is_in(package: str, module: str) -> bool:
    """Return whether a module is the package itself or lies below the package."""
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
    """Return the groups of two or more names that import each other, directly or indirectly."""
    groups: dict[int, list[str]] = {}
    for name, label in components(edges).items() if edges else ():
        groups.setdefault(label, []).append(name)
    return sorted(group for group in groups.values() if len(group) > 1)


def floors(arrows: Edges) -> int:
    """Return the number of groups in the longest chain of arrows; 0 without arrows."""
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
    """Return a module, all modules that it imports directly or indirectly, and their packages."""
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
    """Return the total number of lines in the files."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


def is_mirror(path: Path, root: Path) -> bool:
    """Return whether PACKAGE/FOLDER/NAME exists for LANE/PACKAGE/FOLDER/test_NAME.py."""
    place = root.joinpath(*path.parts[1:-1], path.stem.removeprefix("test_"))
    return place.with_suffix(".py").exists() or (place / "__init__.py").exists()
