"""The figures of the source's structure, on small houses whose figures are known."""

from pathlib import Path

import pytest

from hil.evidence import house

CHAIN = {("p.a", "p.b"), ("p.b", "p.c"), ("p.a", "p.c")}


def test_floors_are_the_longest_chain_and_a_circle_is_one_floor() -> None:
    assert house.floors(CHAIN) == 3
    assert house.floors(CHAIN | {("p.c", "p.b")}) == 2
    assert house.floors(set()) == 0


def test_circles_are_found_however_long() -> None:
    assert house.circles(CHAIN) == []
    assert house.circles(CHAIN | {("p.c", "p.a"), ("p.d", "p.a")}) == [["p.a", "p.b", "p.c"]]


def test_what_is_imported_reaches_its_packages_too() -> None:
    assert house.closure("p.a", {("p.a", "q.r.s"), ("x", "y")}) == {"p.a", "p", "q.r.s", "q.r", "q"}


def test_a_test_mirrors_a_module_or_a_package(tmp_path: Path) -> None:
    for name in ("fsw/drivers/ring.py", "fsw/telemetry/__init__.py"):
        place = tmp_path / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.touch()
    found = {
        name: house.is_mirror(Path(name), tmp_path)
        for name in (
            "unit/fsw/drivers/test_ring.py",
            "virtual/fsw/test_telemetry.py",
            "unit/fsw/drivers/test_speed.py",
            "test_project.py",
        )
    }
    assert list(found.values()) == [True, True, False, False]


def test_the_contract_is_counted_by_layer_and_name(tmp_path: Path) -> None:
    path = tmp_path / "pyproject.toml"
    path.write_text(
        '[[tool.importlinter.contracts]]\nname = "x"\n'
        '[[tool.importlinter.contracts]]\ncontainers = ["fsw"]\nlayers = ["a", "b | c"]\n'
    )
    assert house.contract(path) == [["a"], ["b", "c"]]


@pytest.fixture(scope="module")
def found() -> house.House:
    pytest.importorskip("grimp", reason="needs the extra dev")
    return house.count(house.ROOT)


def test_the_top_of_the_flight_software_is_seen_at_once(found: house.House) -> None:
    assert found.entries <= 16
    assert found.rooms <= 16
    assert found.contract_layers <= 9
    assert found.contract_names <= 16
    assert found.floors <= 9
    assert found.arrows <= 60


def test_nothing_imports_itself_by_a_detour(found: house.House) -> None:
    assert found.circles == []
