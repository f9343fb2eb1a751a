"""Stamps are judged piece by piece, as they would be all at once."""

import numpy as np
import pytest

from offline.stamp_checks import _Steps


@pytest.mark.parametrize("pieces", [1, 2, 7, 40])
def test_steps_of_pieces_are_those_of_the_whole(pieces):
    rng = np.random.default_rng(pieces)
    t_ns = np.cumsum(rng.integers(-5, 100, 40)) * 10**6 + 10**12
    steps = _Steps()
    for part in np.array_split(t_ns, pieces):
        steps.add(part)
    every = np.diff(t_ns)
    low, high = int(every.argmin()), int(every.argmax())
    assert steps.first_ns == t_ns[0]
    assert steps.shortest == (every[low], t_ns[low])
    assert steps.longest == (every[high], t_ns[high])
