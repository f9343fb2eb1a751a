"""Seeds that nobody could choose."""

import pytest

from evidence import provenance
from evidence.provenance import FIRST_FRESH, draw, fresh_seed, seed_or_fresh
from hil.world.scenario import ScenarioError


def test_a_commit_fixes_the_seed_of_a_study(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(provenance, "commit", lambda: "c691e082")
    found = {study: seed_or_fresh(None, study) for study in ("kills", "transfers", "fuzz")}
    assert len(set(found.values())) == 3
    assert min(found.values()) >= FIRST_FRESH
    assert seed_or_fresh(None, "kills") == found["kills"] == fresh_seed("c691e082", "kills")
    monkeypatch.setattr(provenance, "commit", lambda: "c691e083")
    assert seed_or_fresh(None, "kills") != found["kills"]


def test_a_seed_that_is_given_is_used():
    assert seed_or_fresh(7, "kills") == 7
    assert seed_or_fresh(331448962, "kills") == 331448962  # a published draw, made again
    assert draw(7) == "7"


@pytest.mark.parametrize("own", ["unknown", "c691e082+"])
def test_without_a_commit_of_its_own_the_code_has_no_fresh_seed(
    monkeypatch: pytest.MonkeyPatch, own: str
):
    monkeypatch.setattr(provenance, "commit", lambda: own)
    with pytest.raises(ScenarioError, match="this code is"):
        draw(None)
    with pytest.raises(ScenarioError, match="below 1000"):
        draw(1000)
