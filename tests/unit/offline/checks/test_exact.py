"""What check says of an error in an exact constant, beside a fit to readings that have it."""

import re

import numpy as np
import pytest

from fsw.estimators.conditioning.blocks import build_conditioner
from offline.checks.exact import exact_risks
from offline.checks.trial import Stream, Trial, make_trial
from tests.support.estimator_cases import make_config, motion, robot_model, windows


@pytest.fixture(scope="module")
def trial() -> Trial:
    config = make_config()
    own = list(windows(motion("target"), 3, 5.0, 15.0))
    blocks = [b for b in build_conditioner(config, robot_model()).blocks(own) if b is not None]
    return make_trial(config, robot_model(), own, blocks)


def test_an_error_of_a_zero_moves_the_mass_as_check_says(trial: Trial) -> None:
    (line,) = [line for line in exact_risks(trial) if "joints[].zero_sigma_rad" in line]
    found = re.search(r"exact: (\S+) rad of (\S+) moves the mass of target by (\S+) kg", line)
    assert found, line
    size, label, moved_kg = float(found[1]), found[2], float(found[3])
    names = [joint.name for joint in trial.config.joints]
    channel = f"joints.{names.index(label)}"
    own = trial.streams[channel]
    lying = trial.sampled({channel: Stream(own.t_ns, own.values + np.array([size, 0.0]))})
    mass_kg = [one.fit(plain=True).mean[0] for one in (trial, lying)]
    assert abs(mass_kg[1] - mass_kg[0]) == pytest.approx(moved_kg, rel=0.25)


def test_what_is_a_state_is_no_risk(trial: Trial) -> None:
    joints = tuple(
        joint.model_copy(update={"zero_sigma_rad": 1e-3}) for joint in trial.config.joints
    )
    lines = exact_risks(trial.configured(joints=joints))
    assert lines
    assert not [line for line in lines if "zero_sigma_rad" in line]
