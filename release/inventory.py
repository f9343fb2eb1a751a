"""What the flight installation (`pip install .`, no extra) brings with it: licences and sizes.

`python release/inventory.py licences > docs/licences.md`; `python release/inventory.py sizes` in an
environment that has the wheel and nothing else. Exit code 1 where the size is over its bound.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

NAME = "inertia-daemon"
NUMERICS = ("numpy", "scipy", "pin")
BOUND_MB = 150  # of everything but the numerics, and what those need
KNOWN = {"cmeel-qhull": "Qhull"}  # its metadata names none, its COPYING.txt is that licence
HEAD = """\
# Licences of the dependencies

For anyone who passes the program on: every package that `pip install inertia-daemon` brings,
without any extra. Written by `python release/inventory.py licences`, which the tests run. The
program itself: Apache-2.0, with uPlot (MIT) in the page of `fsw report`.

| package | licence |
|---|---|
"""


def closure(name: str) -> set[str]:
    """Return a package's canonical name and those of everything that it needs here."""
    found: set[str] = set()
    waiting = [canonicalize_name(name)]
    while waiting:
        one = waiting.pop()
        if one not in found:
            found.add(one)
            needs = [Requirement(text) for text in distribution(one).requires or ()]
            here = [need for need in needs if need.marker is None or need.marker.evaluate()]
            waiting += [canonicalize_name(need.name) for need in here]
    return found


def licences() -> Iterator[str]:
    """Yield the page of the licences, line by line."""
    names = closure(NAME) - {NAME}
    command = [sys.executable, "-m", "piplicenses", "--from=mixed", "--format=json", "--packages"]
    printed = subprocess.run([*command, *names], capture_output=True, check=True).stdout
    rows = {canonicalize_name(row["Name"]): row["License"] for row in json.loads(printed)} | KNOWN
    yield HEAD.rstrip("\n")
    for name in sorted(names):
        first = rows[name].splitlines()[0]
        yield f"| {name} | {first} |"


def size_mb(one: Distribution) -> float:
    """Return what the files of a package take [MB]."""
    paths = {Path(str(one.locate_file(file))) for file in one.files or ()}
    return sum(path.stat().st_size for path in paths if path.is_file()) / 1e6


def main(what: str) -> int:
    """Print licences or sizes."""
    if what == "licences":
        print("\n".join(licences()))
        return 0
    everything = closure(NAME)
    numerics = set().union(*(closure(name) for name in NUMERICS))
    sizes = {name: size_mb(distribution(name)) for name in everything}
    rest = {name: sizes[name] for name in everything - numerics}
    for name, size in sorted(rest.items(), key=lambda item: -item[1])[:8]:
        print(f"{size:8.1f} MB  {name}")
    total = sum(rest.values())
    print(f"{sum(sizes[n] for n in numerics):8.1f} MB  numpy, scipy, pin and what they need")
    print(f"{total:8.1f} MB  everything else, bound {BOUND_MB}")
    return int(total > BOUND_MB)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
