"""A long batch is passed through in parts: the same estimate, with rows of a part in memory."""

import numpy as np
import pytest

from fsw.estimators.batch.run import run_batch
from fsw.estimators.batch.solver import Target, reduced
from fsw.estimators.measurement import row_functions
from fsw.estimators.measurement.row_functions import Linearisation, row_function
from fsw.estimators.measurement.row_functions import stack as stacked
from fsw.estimators.noise import creep
from tests.support.estimator_cases import make_config, make_problem, noisy_blocks

PART = 12


@pytest.fixture
def in_parts(monkeypatch):
    monkeypatch.setattr(row_functions, "MOST_BLOCKS", PART)
    monkeypatch.setattr(creep, "GROUP", PART)


def test_reduced_rows_have_the_same_products():
    rng = np.random.default_rng(1)
    parts = [(rng.standard_normal((k, 5)), rng.standard_normal(k)) for k in (40, 3, 20)]
    A, b = np.vstack([a for a, _ in parts]), np.concatenate([c for _, c in parts])
    R, c = reduced(reduced(*parts[:2]), parts[2])
    assert len(c) == 6
    assert np.allclose(R.T @ R, A.T @ A, rtol=1e-12, atol=1e-12)
    assert R.T @ c == pytest.approx(A.T @ b, rel=1e-12, abs=1e-12)
    assert c @ c == pytest.approx(b @ b, rel=1e-12)


@pytest.mark.usefixtures("in_parts")
@pytest.mark.parametrize("method", ["fused", "mrnea"])
def test_parts_have_the_rows_of_the_whole(method, monkeypatch):
    problem, blocks = make_problem(), noisy_blocks("target", 1, 16.0)
    rows, x = row_function(method, "eiv", problem), problem.prior_mean
    long = Linearisation(rows, blocks)
    assert max(len(part) for part in long.parts(x)) == PART < len(blocks)
    found = list(long(x))
    fits = [k % 3 > 0 for k in range(len(blocks))]
    assert len(list(long(x, fits))) == len(long(x, fits)) == sum(fits)
    A, b = Target(long, fits)(x)
    monkeypatch.setattr(row_functions, "MOST_BLOCKS", len(blocks))
    whole = list(stacked(rows, blocks, x))
    for own, other in zip(found, whole, strict=True):
        assert np.allclose(own.A, other.A, rtol=1e-12, atol=1e-9)
        assert own.b == pytest.approx(other.b, rel=1e-9, abs=1e-9)
    C, c = Target(Linearisation(rows, blocks), fits)(x)
    assert len(b) == A.shape[1] + 1 < len(c)
    scale = np.sqrt(np.diag(C.T @ C)) + 1e-30
    assert (A.T @ A - C.T @ C) / np.outer(scale, scale) == pytest.approx(0.0, abs=1e-9)
    assert b @ b == pytest.approx(c @ c, rel=1e-9)


@pytest.mark.usefixtures("in_parts")
def test_the_result_of_a_long_batch_is_that_of_one_part(monkeypatch):
    config, blocks = make_config(("target",)), noisy_blocks("target", 2, 20.0)
    found = run_batch(config, blocks, "fused", ("target",))
    monkeypatch.setattr(row_functions, "MOST_BLOCKS", len(blocks))
    whole = run_batch(config, blocks, "fused", ("target",))
    sigma = np.sqrt(np.diag(whole["covariance"]))
    assert (np.array(found["mean"]) - whole["mean"]) / sigma == pytest.approx(0.0, abs=1e-5)
    assert np.sqrt(np.diag(found["covariance"])) == pytest.approx(sigma, rel=1e-6)
    assert [found[key] for key in ("status", "rows", "gated", "reasons")] == [
        whole[key] for key in ("status", "rows", "gated", "reasons")
    ]
