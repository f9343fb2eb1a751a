"""Link-side friction in a simulated world: an honest covariance with its states, a refusal without.

The world's friction is its own (`hil.world.friction`): it turns over linearly, the model's as tanh.
"""

from dataclasses import fields, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from evidence.methods.cases import NODES, RATE_HZ, SENSOR_SETS, WINDOW_S, scenario_of, truth_of
from evidence.methods.exact import exact_samples
from evidence.methods.flight_side import write_config
from evidence.methods.sensed import Channels, condition, declared
from evidence.mistakes.run import samples
from fsw.config import Config
from fsw.estimators.batch.run import run_batch
from fsw.estimators.recursive.online import build_online
from fsw.messages import Block
from hil.world.friction import JointFriction, draw_friction

SEEDS = (0, 1, 2)
SAMPLES = 4000  # 40 s of the motion
COULOMB_NM, VISCOUS_NMS_RAD = 0.3, 0.5


@lru_cache(maxsize=3)
def world(seed: int, folder: Path) -> tuple[Config, tuple[Block, ...], JointFriction]:
    """Return the configuration with friction, blocks of a world with it, and that friction."""
    right = write_config(scenario_of("target"), seed, folder)
    clean, state = samples("target", right, seed), exact_samples("target")
    friction = draw_friction(
        np.random.default_rng(1000 + seed),
        state.q.shape[1],
        coulomb_sigma_nm=COULOMB_NM,
        viscous_sigma_nms_rad=VISCOUS_NMS_RAD,
    )
    rubbed = replace(clean, tau_nm=clean.tau_nm + friction.torque_nm(state.qd))
    begun = {field.name: getattr(rubbed, field.name)[:SAMPLES] for field in fields(rubbed)}
    config = declared(right, SENSOR_SETS["data sheet"], RATE_HZ, window_s=WINDOW_S, nodes=NODES)
    config = with_friction(config, COULOMB_NM, VISCOUS_NMS_RAD)
    return config, tuple(condition(Channels(**begun), config, RATE_HZ)), friction


def with_friction(config: Config, coulomb_nm: float, viscous_nms_rad: float) -> Config:
    update = {
        "friction_coulomb_sigma_nm": coulomb_nm,
        "friction_viscous_sigma_nms_rad": viscous_nms_rad,
    }
    joints = [joint.model_copy(update=update) for joint in config.joints]
    return config.model_copy(update={"joints": joints})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("friction")


def test_bodies_and_friction_have_an_honest_covariance(folder: Path) -> None:
    truth, bodies, joints = truth_of("target"), 0.0, 0.0
    for seed in SEEDS:
        config, blocks, friction = world(seed, folder)
        found = run_batch(config, blocks, "fused", ())
        assert found["status"] == "OK"
        error = np.array(found["mean"])
        error[:10] -= truth
        own = [k for k, name in enumerate(found["names"]) if name.startswith("friction")]
        error[own] -= np.concatenate([friction.coulomb_nm, friction.viscous_nms_rad])
        P = np.array(found["covariance"])
        bodies += error[:10] @ np.linalg.solve(P[:10, :10], error[:10])
        joints += error[own] @ np.linalg.solve(P[np.ix_(own, own)], error[own])
        assert np.sqrt(P[own[0], own[0]]) < 0.02 * COULOMB_NM  # the data tell it
    assert chi2.ppf(0.0005, 10 * len(SEEDS)) < bodies < chi2.ppf(0.9995, 10 * len(SEEDS))
    assert joints < chi2.ppf(0.9999, 14 * len(SEEDS))


def test_the_recursion_gives_the_same(folder: Path) -> None:
    config, blocks, _ = world(0, folder)
    online = build_online(config)
    for block in blocks:
        online.push(block)
    found, batch = online.finish(), run_batch(config, blocks, "fused", ())
    assert found.valid, found.reason
    assert found.names == tuple(batch["names"])
    step = (found.mean - np.array(batch["mean"]))[:10]
    assert np.abs(step / np.sqrt(np.diag(found.covariance))[:10]).max() < 0.1


def test_without_the_states_the_result_is_refused(folder: Path) -> None:
    config, blocks, _ = world(0, folder)
    found = run_batch(with_friction(config, 0.0, 0.0), blocks[:60], "fused", ())
    assert found["status"] == "MODEL_MISMATCH"
