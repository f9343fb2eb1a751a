"""A batch that cannot fit ends early with the same verdict; counted in linearisations."""

from dataclasses import replace

import pytest

from fsw.estimators.batch.run import run_batch
from fsw.estimators.batch.solver import Target
from tests.support.estimator_cases import make_config, noisy_blocks

STOP_S = 24.0
MOST = 250  # linearisations: two solutions of 110 each; six were made


@pytest.fixture
def asked(monkeypatch):
    """Count the linearisations."""
    calls, call = [], Target.__call__

    def counted(self, x):
        calls.append(x)
        return call(self, x)

    monkeypatch.setattr(Target, "__call__", counted)
    return calls


@pytest.mark.parametrize("kind", ["target", "base"])
def test_the_wrong_sign_of_all_torques_ends_early(kind, asked):
    config = make_config(("target",) if kind == "target" else ("base",), doubt=True)
    blocks = [replace(block, tau_nm=-block.tau_nm) for block in noisy_blocks(kind, 1, STOP_S)]
    found = run_batch(config, blocks, "fused", tuple(config.unknown))
    assert found["reasons"] == ["MODEL_MISMATCH"]
    assert len(asked) <= MOST
    assert "times the declared noise" in found["note"]


def test_a_joint_whose_torque_fails_in_some_windows_is_still_left_out(asked):
    """The first solution is far off; the windows that do not fit are left out, the rest fits."""
    config, blocks = make_config(("target",), doubt=True), noisy_blocks("target", 2, STOP_S)
    for k in range(10, 16):
        tau_nm = blocks[k].tau_nm.copy()
        tau_nm[:, 1] = 90.0
        blocks[k] = replace(blocks[k], tau_nm=tau_nm)
    found = run_batch(config, blocks, "fused", ("target",))
    assert found["status"] == "OK", found["note"]
    assert found["gated"] == 6
    assert len(asked) <= MOST
