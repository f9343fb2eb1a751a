"""Arithmetic that fails is a reset with its event, or an error with words; never a traceback."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsw.errors import EstimatorError
from fsw.estimators.batch import settle, solver
from fsw.estimators.batch.run import run_batch
from fsw.estimators.recursive import recursion
from fsw.estimators.recursive.online import build_online
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import Block, FloatArray
from tests.support.estimator_cases import (
    NODES,
    SENSOR_B_M,
    draw_biases,
    make_config,
    motion,
    noisy,
    noisy_blocks,
    robot_model,
    true_block,
)


def throw(rate_rad_s: float, count: int) -> list[Block]:
    """Return blocks of a robot with its arm at rest that tumbles at a constant rate."""
    rng = np.random.default_rng(0)
    w = rng.normal(size=3)
    w *= rate_rad_s / np.linalg.norm(w)
    force = np.cross(w, np.cross(w, np.array(SENSOR_B_M)))
    blocks = []
    for k in range(count):
        block = true_block(motion("base"), 3.0 + 0.4 * k, k)
        zero = np.zeros_like(block.q_rad)
        still = replace(
            block,
            q_rad=zero,
            qd_rad_s=zero,
            qdd_rad_s2=zero,
            tau_nm=zero,
            w_NB_B_rad_s=np.tile(w, (NODES, 1)),
            wd_NB_B_rad_s2=np.zeros((NODES, 3)),
            f_NS_B_m_s2=np.tile(force, (NODES, 1)),
            R_NB=Rotation.from_rotvec(np.outer(block.t_ns * 1e-9, w)).as_matrix(),
        )
        blocks.append(noisy(still, rng, draw_biases(rng)))
    return blocks


def at_no_momentum(block: Block) -> Block:
    """Return the block of a robot at perfect rest."""
    names = ("q_rad", "qd_rad_s", "qdd_rad_s2", "tau_nm")
    rates = ("w_NB_B_rad_s", "wd_NB_B_rad_s2", "f_NS_B_m_s2")
    still = {name: np.zeros_like(getattr(block, name)) for name in (*names, *rates)}
    return replace(block, **still, R_NB=np.stack([np.eye(3)] * NODES))


def without(block: Block, *, joints: bool, imu: bool) -> Block:
    """Return the block without its joints' torques, or the inertial unit's channels."""
    return replace(
        block,
        has_joint=block.has_joint & (not joints),
        has_gyro=not imu,
        has_accelerometer=not imu,
        has_attitude=not imu,
    )


def without_noise(block: Block) -> Block:
    """Return the block with covariances of nothing: every root of them is singular."""
    names = ("cov_joint", "cov_tau", "cov_gyro", "cov_acc")
    return replace(block, **{name: 0.0 * getattr(block, name) for name in names})


def as_large_as_possible(block: Block) -> Block:
    """Return the block with values just within what is plausible."""
    values = {"tau_nm": 9e4, "qd_rad_s": 90.0, "qdd_rad_s2": 9e4, "f_NS_B_m_s2": 9e3}
    return replace(block, **{k: np.full_like(getattr(block, k), v) for k, v in values.items()})


DEGENERATE: dict[str, Callable[[Block], Block]] = {
    "no momentum": at_no_momentum,
    "no sensor": lambda block: without(block, joints=True, imu=True),
    "no torque": lambda block: without(block, joints=True, imu=False),
    "no inertial unit": lambda block: without(block, joints=False, imu=True),
    "no noise": without_noise,
    "one instant": lambda block: replace(block, t_ns=np.zeros_like(block.t_ns)),
    "no attitude matrix": lambda block: replace(block, R_NB=0.0 * block.R_NB),
    "largest values": as_large_as_possible,
}
METHODS = (
    *(("mrnea", "eiv"), ("mrnea", "ols"), ("mrnea", "wls")),
    *(("rda", "eiv"), ("cm", "eiv"), ("fused", "eiv")),
)


@cache
def moving() -> tuple[Block, ...]:
    return tuple(true_block(motion("base"), 0.4 * k, k) for k in range(6))


@pytest.mark.parametrize(("method", "weighting"), METHODS)
@pytest.mark.parametrize("kind", [*DEGENERATE, "throw"])
@pytest.mark.parametrize("momentum_sigma_nms", [0.0, 30.0])
def test_degenerate_data_end_the_recursion_nowhere_in_a_traceback(
    momentum_sigma_nms: float,
    kind: str,
    method: str,
    weighting: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    blocks = throw(3.0, 6) if kind == "throw" else [DEGENERATE[kind](b) for b in moving()]
    options = {"method": method, "weighting": weighting, "momentum_sigma_nms": momentum_sigma_nms}
    config = make_config(("base",), target=None, **options)
    online = build_online(config, robot_model())
    for block in blocks:
        estimate = online.push(block)
        assert np.isfinite(estimate.mean).all()
        assert np.isfinite(estimate.covariance).all()
    final = online.finish()
    assert not final.valid or kind not in ("no momentum", "no sensor", "throw")
    online.report()
    assert capfd.readouterr() == ("", "")  # a library's complaint is no event


@pytest.mark.parametrize(("method", "weighting"), [*METHODS, ("ce", "eiv")])
@pytest.mark.parametrize("kind", [*DEGENERATE, "throw"])
@pytest.mark.parametrize("momentum_sigma_nms", [0.0, 30.0])
def test_degenerate_data_end_a_batch_with_a_status_or_in_words(
    momentum_sigma_nms: float,
    kind: str,
    method: str,
    weighting: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    chosen = "fused" if method == "ce" else method
    options = {"method": chosen, "weighting": weighting, "momentum_sigma_nms": momentum_sigma_nms}
    config = make_config(("base",), target=None, **options)
    blocks = throw(3.0, 6) if kind == "throw" else [DEGENERATE[kind](b) for b in moving()]
    with suppress(EstimatorError):
        result = run_batch(config, blocks, method, ())
        assert np.isfinite(result["covariance"]).all()
        assert result["status"] != "OK" or kind not in ("no momentum", "no sensor")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("rates_rad_s", "resets"),
    [((60.0, 100.0), True), ((0.1,), False)],  # rounding decides which of the fast throws resets
    ids=["from rest", "from the first rate"],
)
def test_a_throw_with_much_momentum_resets_the_recursion_and_says_so(
    rates_rad_s: tuple[float, ...], resets: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if resets:
        monkeypatch.setattr(recursion, "at_first_rate", lambda _, x, __: x)
    config = make_config(("base",), target=None, method="fused", momentum_sigma_nms=10.0)
    codes = []
    for rate_rad_s in rates_rad_s:
        online = build_online(config, robot_model())
        for block in throw(rate_rad_s, 40):
            estimate = online.push(block)
            assert np.isfinite(estimate.mean).all()
            assert np.isfinite(estimate.covariance).all()
        assert not online.finish().valid
        codes += [code for _, code, _ in online.events()]
    assert ("ESTIMATOR_RESET" in codes) == resets


@pytest.mark.parametrize("error", [np.linalg.LinAlgError("singular"), ZeroDivisionError()])
@pytest.mark.parametrize("unit", ["fold", "work", "settle"])
def test_any_failing_unit_of_the_recursion_is_a_reset(
    unit: str, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    online = build_online(make_config(), robot_model())
    blocks = noisy_blocks("target", 1, 4.0)
    for block in blocks[:-1]:
        online.push(block)

    def fails(*_: object) -> object:
        raise error

    monkeypatch.setattr(online.recursion, unit, fails)
    online.push(blocks[-1])
    final = online.finish()
    assert not final.valid
    assert "ESTIMATOR_RESET" in [code for _, code, _ in online.events()]


def test_a_failing_batch_is_an_error_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> object:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(settle, "minimise", fails)
    with pytest.raises(EstimatorError, match=r"arithmetic fails .*Singular matrix"):
        run_batch(make_config(), noisy_blocks("target", 1, 4.0), "fused", ())


def test_a_regression_that_meets_its_limit_is_not_ok(monkeypatch: pytest.MonkeyPatch) -> None:
    config = make_config(method="mrnea", weighting="ols")
    blocks = noisy_blocks("target", 1, 12.0)
    assert run_batch(config, blocks, "mrnea", ())["status"] == "OK"
    monkeypatch.setattr(solver, "MAX_PLAIN_STEPS", 1)
    assert run_batch(config, blocks, "mrnea", ())["status"] == "NOT_CONVERGED"


def test_a_restart_in_the_middle_of_a_block_leaves_nothing_of_the_old_residuals(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The regression's residual variance is that of the blocks after the restart alone."""
    config = make_config(method="mrnea", weighting="ols")
    online = build_online(config, robot_model())
    data = noisy_blocks("target", 3, 12.0)
    for block in data[:12]:
        online.push(block)
    assert online.recursion.residual_variance() != 1.0
    solve, failures = SquareRootInformation.mean, iter([True])

    def fail_once(information: SquareRootInformation) -> FloatArray:
        if next(failures, False):
            raise EstimatorError("information is singular")
        return solve(information)

    with monkeypatch.context() as patched:
        patched.setattr(SquareRootInformation, "mean", fail_once)
        online.recursion.fold(data[12])
    assert [code for _, code, _ in online.events()] == ["ESTIMATOR_RESET"]
    fresh = build_online(config, robot_model())
    for block in data[13:]:
        online.push(block)
        fresh.push(block)
    assert online.recursion.residual_variance() == fresh.recursion.residual_variance()
