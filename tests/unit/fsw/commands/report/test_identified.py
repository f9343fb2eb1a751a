"""The headline of a batch result's page."""

import pytest

from fsw.commands.report.identified import judged


@pytest.mark.parametrize(
    ("status", "passed", "valid", "headline"),
    [
        ("OK", None, True, "VALID"),
        ("OK", True, True, "VALID: held-out windows PASSED"),
        ("OK", False, False, "NOT VALID: held-out windows FAILED"),
        ("NOT_CONVERGED", None, False, "NOT VALID: NOT_CONVERGED"),
        ("NOT_CONVERGED", True, False, "NOT VALID: NOT_CONVERGED, held-out windows PASSED"),
    ],
)
def test_the_headline_says_what_the_page_is_marked_as(status, passed, valid, headline):
    assert judged(status, passed) == (valid, headline)
