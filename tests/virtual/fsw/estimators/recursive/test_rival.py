"""After an alarm the estimate before it continues, until the following blocks decide."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.recursive.online import OnlineEstimator, build_online
from fsw.messages import Block
from tests.support.estimator_cases import draw_biases, make_config, noisy, noisy_blocks, robot_model
from tests.support.starts import STEP_AT, stepped
from tests.virtual.fsw.estimators.recursive.test_snapshot import assert_same, restored

FALSE_AT = 90
DECIDED_BLOCKS = 40  # within which a false alarm is refuted


def with_three_bad_blocks() -> list[Block]:
    """Return a flight of which three windows fit nothing: three in a row are an alarm."""
    blocks = noisy_blocks("target", 5)
    for k in range(FALSE_AT, FALSE_AT + 3):
        blocks[k] = replace(blocks[k], tau_nm=blocks[k].tau_nm + 3.0)
    return blocks


def make() -> OnlineEstimator:
    return build_online(make_config(), robot_model())


def test_a_false_alarm_costs_some_windows_and_no_information() -> None:
    """Invalid while undecided, then as if the three windows alone had been left out."""
    blocks = with_three_bad_blocks()
    online, spared = make(), make()
    codes, states = [], []
    for k, block in enumerate(blocks):
        estimate = online.push(block)
        states.append((estimate.valid, estimate.reason))
        codes += [(code, k) for _, code, _ in online.events()]
        if not FALSE_AT <= k < FALSE_AT + 3:
            spared.push(block)
    alarm, end = FALSE_AT + 2, codes[-1][1]
    assert [code for code, _ in codes] == ["CHANGE_DETECTED", "CHANGE_REFUTED"]
    assert codes[0][1] == alarm
    assert end <= alarm + DECIDED_BLOCKS
    assert set(states[alarm:end]) == {(False, "REOPENED")}
    assert set(states[end:]) == {(True, "")}
    final, other = online.finish(), spared.finish()
    assert final.gated == 3
    sigma = np.sqrt(np.diag(other.covariance))
    assert np.abs((final.mean - other.mean) / sigma).max() < 0.02
    np.testing.assert_allclose(np.sqrt(np.diag(final.covariance)) / sigma, 1.0, rtol=1e-3)


@pytest.mark.parametrize("ratio", [1.05, 1.005])
def test_a_change_refutes_the_old_estimate_at_once(ratio: float) -> None:
    rng = np.random.default_rng(4)
    biases = draw_biases(rng)
    online, alarm, decided = make(), 0, 0
    for clean in stepped("target", 1.0, ratio):
        estimate = online.push(noisy(clean, rng, biases))
        for _, code, _ in online.events():
            assert code == "CHANGE_DETECTED"
            alarm = clean.index
        if alarm and not decided and online.rival is None:
            decided = clean.index
    assert STEP_AT <= alarm < STEP_AT + 5
    assert decided <= alarm + 6
    assert estimate.valid


def test_a_restore_while_undecided_continues_to_the_bit() -> None:
    through, broken, undecided = make(), make(), 0
    for k, block in enumerate(with_three_bad_blocks()):
        assert_same(through.push(block), broken.push(block))
        if through.rival is not None and k % 4 == 0:
            undecided += 1
            again = restored(broken, make)
            broken = again
    assert undecided > 1
    assert_same(through.finish(), broken.finish())
    assert through.report() == broken.report()
