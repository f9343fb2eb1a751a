"""A word for every published parameter: measured, prior-dominated, unbounded or not valid."""

from typing import Any

import numpy as np
import pytest

from fsw.estimators.diagnosis import diagnose, plain
from fsw.estimators.model.inertia import NAMES, report_jacobian, to_parameters
from fsw.estimators.parameter_verdicts import in_words, parameter_verdicts
from fsw.messages import BodyEstimate
from offline.replay_result import known_by

MASS, COM, INERTIA = 0.5, np.array([0.01, 0.0, 0.1]), np.array([5e-3, 0, 0, 5e-3, 0, 4e-3])


def payload(inertia_sigma: float) -> BodyEstimate:
    return BodyEstimate(
        mass_kg=MASS,
        com_m=COM,
        inertia_kg_m2=INERTIA,
        mass_sigma_kg=0.005,
        com_sigma_m=np.full(3, 2e-3),
        inertia_sigma_kg_m2=np.full(6, inertia_sigma),
        physically_consistent=True,
    )


PRIOR = np.array([0.25, *[0.05] * 3, *[4e-3] * 6])


@pytest.mark.parametrize(
    ("inertia_sigma", "prior_sigma", "word"),
    [
        (1e-3, 4e-3, "measured"),
        (3.9e-3, 4e-3, "prior-dominated"),
        (0.03, 0.04, "unbounded"),
        (0.01, 0.04, "unbounded"),
    ],
)
def test_light_payload(inertia_sigma: float, prior_sigma: float, word: str) -> None:
    prior = np.concatenate([PRIOR[:4], np.full(6, prior_sigma)])
    words = parameter_verdicts(payload(inertia_sigma), prior, ["INSUFFICIENT_EXCITATION"])
    assert words == {"mass_kg": "measured", "com_m": ["measured"] * 3, "inertia_kg_m2": [word] * 6}


@pytest.mark.parametrize("reason", ["MODEL_MISMATCH", "NOT_CONVERGED", "TOO_FEW_BLOCKS"])
def test_of_a_model_that_does_not_fit_nothing_is_of_use(reason: str) -> None:
    words = parameter_verdicts(payload(1e-3), PRIOR, [reason])
    assert in_words(words) == "every parameter not valid"


def test_a_worse_reason_is_not_hidden_by_too_little_excitation() -> None:
    reasons = ["MODEL_MISMATCH", "INSUFFICIENT_EXCITATION"]
    assert (
        in_words(parameter_verdicts(payload(1e-3), PRIOR, reasons)) == "every parameter not valid"
    )


def test_sigma_that_is_no_number_is_unbounded() -> None:
    assert parameter_verdicts(payload(np.nan), PRIOR, [])["inertia_kg_m2"] == ["unbounded"] * 6


def diagnosis(*reasons: str, inertia_sigma: float = 3.9e-3) -> dict[str, Any]:
    mean = to_parameters(MASS, COM, INERTIA)
    back = np.linalg.solve(report_jacobian(mean), np.eye(10))
    after = np.array([0.005, *[2e-3] * 3, *[inertia_sigma] * 6])
    names = [f"target.{name}" for name in NAMES]
    found = diagnose(
        names=names,
        prior_mean=mean,
        prior_covariance=back @ np.diag(PRIOR**2) @ back.T,
        mean=mean,
        covariance=back @ np.diag(after**2) @ back.T,
        bodies={"target": payload(inertia_sigma)},
        duration_s=60.0,
        reasons=reasons,
    )
    return plain(found, names)


def test_verdict_and_words_agree() -> None:
    short = diagnosis("INSUFFICIENT_EXCITATION")
    assert short["parameters"]["target"]["mass_kg"] == "measured"
    assert short["verdict"]["target"].startswith("target mass identified to +-1 %")
    assert "not valid, INSUFFICIENT_EXCITATION" in short["verdict"]["target"]
    assert "prior-dominated: Ixx" in short["verdict"]["target"]
    wrong = diagnosis("MODEL_MISMATCH")
    assert "not identified" in wrong["verdict"]["target"]
    assert known_by(wrong, "target") == ["target: every parameter not valid"]
    assert known_by(short, "target") == [
        "target: measured: mass x y z; prior-dominated: Ixx Ixy Ixz Iyy Iyz Izz"
    ]
    assert known_by(None, "target") == []
