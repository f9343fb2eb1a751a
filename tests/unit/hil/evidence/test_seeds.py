"""The summary of many seeds, on outcomes made by hand."""

from typing import Any

import pytest
from scipy.stats import chi2

from hil.evidence.seeds import summary


def outcome(mass_kg: float, nees: float, wrong: int = 0) -> dict[str, Any]:
    return {
        "scenario": "s",
        "unknown": ["target"],
        "truth": {"target": {"mass_kg": 400.0}},
        "estimate": {"target": {"mass_kg": mass_kg}},
        "sigma": {"target": {"mass_kg": 1.0}},
        "mass_sigma_to_crb_ratio": {"target": 1.2},
        "nees": nees,
        "dof": 10,
        "valid": True,
        "outputs": {"valid": 150, "wrong": wrong},
        "ee_error": {"mean_position_m": 1e-5},
        "samples": {"imu": {"received": 9, "lost": 1, "late": 0, "rejected": 2}},
        "slips": 0,
        "simulated_s": 65.0,
        "wall_s": 13.0,
    }


def test_counts_and_band_are_those_of_the_runs() -> None:
    total = summary([outcome(400.5, 8.0), outcome(402.0, 14.0, 3), outcome(396.0, 11.0)])
    assert total["mean_nees"] == pytest.approx(11.0)
    assert total["nees_band_99"][0] == pytest.approx(chi2.ppf(0.005, 30) / 3)
    assert total["bodies"]["target"]["within_0.3_percent"] == 1
    assert total["bodies"]["target"]["within_3_sigma"] == 2
    assert total["bodies"]["target"]["worst_mass_error_ratio"] == pytest.approx(0.01)
    assert (total["lost"], total["rejected"], total["late"]) == (3, 6, 0)
    assert total["ever_valid_and_wrong"] == 1
    assert total["slowest_speed_ratio"] == pytest.approx(5.0)
