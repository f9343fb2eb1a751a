"""Of a long recording some stretches of windows are kept, evenly spread."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fsw.estimators.conditioning.blocks import Conditioner
from offline.checks.trial import MOST, _head
from offline.watching import STRETCH, Watching


@pytest.fixture
def seen(monkeypatch) -> Watching:
    """Return a conditioner whose blocks have the index of their window; every tenth is missing."""

    def blocks(_self: object, windows: list[Any]) -> list[Any]:
        return [None if w.index % 10 == 0 else SimpleNamespace(index=w.index) for w in windows]

    monkeypatch.setattr(Conditioner, "__init__", lambda *_: None)
    monkeypatch.setattr(Conditioner, "blocks", blocks)
    return Watching(cast(Any, None), (), most=4 * STRETCH)


def feed(seen: Watching, count: int) -> None:
    for first in range(0, count, 100):
        seen.blocks(
            [cast(Any, SimpleNamespace(index=k)) for k in range(first, min(count, first + 100))]
        )


def test_a_short_recording_is_kept_whole(seen):
    feed(seen, 4 * STRETCH)
    assert [w.index for w in seen.windows] == list(range(4 * STRETCH))
    assert len(seen.made) == sum(k % 10 > 0 for k in range(4 * STRETCH))


@pytest.mark.parametrize("stretches", [4.01, 7.3, 8, 100, 215.5])
def test_a_long_one_is_kept_in_stretches_from_its_start_to_its_end(seen, stretches):
    count = round(stretches * STRETCH)
    feed(seen, count)
    index = np.array([w.index for w in seen.windows])
    assert len(index) <= 4 * STRETCH
    assert index[:STRETCH].tolist() == list(range(STRETCH))
    assert STRETCH > MOST
    starts = index[np.flatnonzero(np.diff(index, prepend=-9) != 1)] // STRETCH
    assert len(set(np.diff(starts))) == 1  # evenly spread
    assert count - index[-1] <= np.diff(starts)[0] * STRETCH
    kept = set(index.tolist())
    assert [b.index for b in seen.made] == [k for k in index.tolist() if k % 10]
    assert kept >= {b.index for b in seen.made}


def test_no_run_of_a_trial_leads_over_missing_windows():
    def window(index: int, solutions: int) -> Any:
        attitude = SimpleNamespace(t_ns=np.zeros(solutions))
        return SimpleNamespace(index=index, attitude=attitude)

    together = [window(k, int(k == 5)) for k in range(5, 9)]
    assert _head(together, 3) == 0
    apart = [window(5, 1), *(window(k, 0) for k in range(300, 303))]
    assert _head(apart, 3) == 3
