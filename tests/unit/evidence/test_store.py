"""The journal of results: nothing lost in a crash, nothing twice, nothing of other settings."""

from pathlib import Path

import pytest

from evidence import pool, runner
from evidence.store import JOURNAL, Store, results_in
from hil.world.scenario import ScenarioError

SETTINGS = {"seed": 1}


def test_rows_are_read_again_as_they_were_written_the_newest_of_a_key(tmp_path: Path) -> None:
    store = Store(tmp_path, SETTINGS)
    for key, value in (("a", 0.1 + 0.2), ("b", None), ("a", [1, 2])):
        store.add(key, {"value": value})
    assert (
        Store(tmp_path, SETTINGS).rows
        == store.rows
        == {
            "a": {"value": [1, 2]},
            "b": {"value": None},
        }
    )


@pytest.mark.parametrize("cut", [1, 7])
def test_a_line_cut_off_by_a_crash_is_discarded_and_can_be_written_again(
    tmp_path: Path, cut: int
) -> None:
    store = Store(tmp_path, SETTINGS)
    store.add("a", {"x": 1})
    store.add("b", {"x": 2})
    path = tmp_path / JOURNAL
    path.write_bytes(path.read_bytes()[:-cut])
    again = Store(tmp_path, SETTINGS)
    assert list(again.rows) == ["a"]
    again.add("b", {"x": 3})
    assert Store(tmp_path, SETTINGS).rows["b"] == {"x": 3}


def test_results_of_other_settings_are_refused(tmp_path: Path) -> None:
    Store(tmp_path, SETTINGS)
    with pytest.raises(ScenarioError, match="other settings"):
        Store(tmp_path, {"seed": 2})


def test_rows_that_are_forgotten_are_gone_from_the_disk(tmp_path: Path) -> None:
    store = Store(tmp_path, SETTINGS)
    for key in "abc":
        store.add(key, {})
    store.forget({"b"})
    assert list(store.rows) == list(Store(tmp_path, SETTINGS).rows) == ["a", "c"]


def test_without_a_folder_rows_are_kept_in_memory() -> None:
    store = Store(None, SETTINGS)
    store.add("a", {"x": 1})
    store.forget({"b"})
    assert store.rows == {"a": {"x": 1}}


def test_only_what_is_missing_runs_and_every_row_is_stored(tmp_path: Path) -> None:
    ran: list[int] = []

    def work(case: int) -> dict[str, dict[str, int]]:
        ran.append(case)
        return {str(case): {"square": case**2}}

    for cases in ([1, 2], [1, 2, 3]):
        store = Store(tmp_path, SETTINGS)
        rest = runner.missing(cases, str, store)
        assert list(runner.stored(pool.one_by_one(work, rest), store)) == rest
    assert ran == [1, 2, 3]
    assert Store(tmp_path, SETTINGS).rows["3"] == {"square": 9}


@pytest.mark.parametrize("line", ['{"key": 1, "value": 2}', "17", '["a", 3]', '["a"]', "nonsense"])
def test_results_of_another_version_are_refused_in_one_line(tmp_path: Path, line: str) -> None:
    Store(tmp_path, SETTINGS).add("a", {"value": 1})
    (tmp_path / JOURNAL).write_text(line + "\n")
    with pytest.raises(ScenarioError, match="another version; give an empty folder"):
        Store(tmp_path, SETTINGS)


def test_results_without_a_folder_are_gone_with_the_block(tmp_path: Path) -> None:
    with results_in(None) as folder:
        (folder / "a").touch()
    assert not folder.exists()
    with results_in(tmp_path / "new" / "one") as folder:
        assert folder.is_dir()
    assert folder.is_dir()
    (tmp_path / "file").touch()
    with pytest.raises(ScenarioError, match="--out"), results_in(tmp_path / "file"):
        pass
