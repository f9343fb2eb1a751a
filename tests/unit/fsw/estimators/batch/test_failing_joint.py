"""A joint whose torque fails in some windows."""

from dataclasses import replace

from fsw.estimators.batch.run import run_batch
from tests.support.estimator_cases import make_config, noisy_blocks

STOP_S = 24.0


def test_a_joint_whose_torque_fails_in_some_windows_is_still_left_out():
    """The first solution is far off; the windows that do not fit are left out, the rest fits."""
    config, blocks = make_config(("target",), doubt=True), noisy_blocks("target", 2, STOP_S)
    for k in range(10, 16):
        tau_nm = blocks[k].tau_nm.copy()
        tau_nm[:, 1] = 90.0
        blocks[k] = replace(blocks[k], tau_nm=tau_nm)
    found = run_batch(config, blocks, "fused", ("target",))
    assert found["status"] == "OK", found["note"]
    assert found["gated"] == 6
