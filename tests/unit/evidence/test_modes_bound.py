"""The bound with modes: what it varies, and what it refuses."""

from pathlib import Path

import numpy as np
import pytest

from evidence.modes.command import STEPS, _pairs, information, study
from hil.world.scenario import ScenarioError, load


def test_every_value_of_bodies_and_modes_is_varied_alone() -> None:
    scenario = load("base_slosh")
    pairs = list(_pairs(scenario))
    assert len(pairs) == 10 + 3 * len(scenario.slosh)
    for k, (more, less, step) in enumerate(pairs[:10]):
        np.testing.assert_allclose(
            more.truth["base"] - less.truth["base"], 2 * step * np.eye(10)[k]
        )
        assert step == STEPS[k]
        assert more.slosh == scenario.slosh
    for k, (more, less, step) in enumerate(pairs[10:]):
        changed = [i for i, part in enumerate(more.slosh) if part != scenario.slosh[i]]
        assert changed == [k // 3]
        own, other = more.slosh[k // 3], less.slosh[k // 3]
        each = [
            own.mass_kg / other.mass_kg,
            own.frequency_hz / other.frequency_hz,
            own.damping_ratio / other.damping_ratio,
        ]
        wanted = np.ones(3)
        wanted[k % 3] = np.exp(2 * step)
        np.testing.assert_allclose(each, wanted, rtol=1e-4)


def test_what_has_no_modes_or_no_runs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="panels or liquid"):
        information(load("base"))
    with pytest.raises(ScenarioError, match="--runs"):
        study("base_slosh", tmp_path)
