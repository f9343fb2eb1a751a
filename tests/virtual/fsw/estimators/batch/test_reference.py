"""A reference without the target tells arm and friction: half the error of the plain batch."""

from pathlib import Path

import pytest

from evidence.differential.command import case, differential, lines
from fsw.errors import EstimatorError
from fsw.estimators.batch.run import run_batch


def test_a_reference_halves_the_error_of_the_mass_and_stays_honest(tmp_path: Path) -> None:
    """The short form of `hil differential`; what has run is not run again."""
    found = differential(range(3), 1, tmp_path)
    assert found["passed"], found
    kept = (tmp_path / "results.jsonl").read_text(encoding="utf-8")
    assert differential(range(3), 1, tmp_path) == found
    assert (tmp_path / "results.jsonl").read_text(encoding="utf-8") == kept
    assert "at most 0.5: ok" in lines(found)


def test_a_reference_with_the_target_in_it_is_refused(tmp_path: Path) -> None:
    config, loaded, _ = case(0, tmp_path)
    with pytest.raises(EstimatorError, match="reference"):
        run_batch(config, loaded, "fused", (), reference=loaded)


def test_a_regression_takes_no_reference(tmp_path: Path) -> None:
    config, loaded, empty = case(0, tmp_path)
    with pytest.raises(EstimatorError, match="takes arm and calibration as exact"):
        run_batch(config, loaded[:10], "ce", (), reference=empty[:10])
