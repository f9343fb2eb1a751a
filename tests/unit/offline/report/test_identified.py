"""The headline of a batch result's page."""

import pytest

from offline.report.identified import judged


@pytest.mark.parametrize(
    ("reasons", "passed", "valid", "headline"),
    [
        ((), None, True, "VALID"),
        ((), True, True, "VALID: held-out windows PASSED"),
        ((), False, False, "NOT VALID: held-out windows FAILED"),
        (("NOT_CONVERGED",), None, False, "NOT VALID: NOT_CONVERGED"),
        (("NOT_CONVERGED",), True, False, "NOT VALID: NOT_CONVERGED, held-out windows PASSED"),
        (
            ("NOT_CONVERGED", "TOO_FEW_BLOCKS"),
            None,
            False,
            "NOT VALID: NOT_CONVERGED, TOO_FEW_BLOCKS",
        ),
    ],
)
def test_the_headline_says_what_the_page_is_marked_as(reasons, passed, valid, headline):
    assert judged(reasons, passed) == (valid, headline)
