"""What a flight would tell, with every state of the configuration."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from evidence.excitation import cases
from fsw.config import Config
from planner import criteria
from planner.assess import information_root
from planner.firings import Firing
from planner.foreseen import foreseen_blocks, foreseen_root, whole_problem
from planner.subject import Subject, build_subject
from tests.support.excitation_cases import PANEL, SHORT, motion

TRAJECTORY = SHORT.trajectory(motion())
JET = {
    "name": "jet",
    "bus": "arm",
    "node_id": 0x31,
    "rate_hz": 50.0,
    "p_B_m": (0.0, 0.0, 1.0),
    "direction_B": (1.0, 0.0, 0.0),
    "force_n": 22.0,
}
TRACKER = {
    "port": "tracker",
    "rate_hz": 5.0,
    "latency_s": 0.1,
    "noise_across_rad": 1e-5,
    "noise_about_rad": 5e-5,
    "mounting": {"p_BS_m": (0.0, 0.0, 0.0), "q_BS_xyzw": (0.0, 0.0, 0.0, 1.0)},
}


def document(system: str = "target") -> dict[str, Any]:
    """Return a configuration in which arm, mounting and known bodies are exact."""
    found = cases.config(system).model_dump()
    for name in set(found["bodies"]) - set(found["unknown"]):
        found["bodies"][name]["sigma"] = None
    found["star_tracker"] = TRACKER
    found["imu"] |= {"mounting_position_sigma_m": 0.0, "mounting_angle_sigma_rad": 0.0}
    return found


def with_sections(**sections: object) -> Subject:
    return build_subject(Config.model_validate(document() | sections))


def sigma(own: Subject, root: np.ndarray) -> np.ndarray:
    return np.sqrt(np.diag(criteria.report_covariance(root, own.scale)))


def test_where_nothing_else_is_in_doubt_it_is_what_the_solver_sees():
    own = with_sections()
    seen = sigma(own, information_root(own, TRAJECTORY, 10.0))
    np.testing.assert_allclose(sigma(own, foreseen_root(own, TRAJECTORY)), seen, rtol=0.02)


@pytest.mark.parametrize(
    ("section", "change", "states"),
    [
        ("estimator", {"external_force_sigma_n": 0.1, "external_torque_sigma_nm": 0.1}, 6),
        ("robot", {"links_sigma_ratio": 0.05}, 80),
        ("joints", {"friction_coulomb_sigma_nm": 0.5, "friction_viscous_sigma_nms_rad": 0.5}, 14),
        ("joints", {"torque_delay_sigma_s": 0.02}, 7),
    ],
)
def test_what_is_in_doubt_widens_sigma(section, change, states):
    held, exact = document()[section], with_sections()
    new = [part | change for part in held] if section == "joints" else held | change
    own = with_sections(**{section: new})
    assert len(whole_problem(own)[0].names) == len(whole_problem(exact)[0].names) + states
    wider = sigma(own, foreseen_root(own, TRAJECTORY)) / sigma(
        exact, foreseen_root(exact, TRAJECTORY)
    )
    assert wider.min() > 0.99
    assert wider.max() > 1.01


def test_a_panel_and_an_idle_thruster_are_states_of_the_plan():
    own = with_sections(modes=(PANEL,), thrusters=(JET,), estimator={"momentum_sigma_nms": 1.0})
    assert any(name.startswith("mode_frequency") for name in whole_problem(own)[0].names)
    assert np.isfinite(sigma(own, foreseen_root(own, TRAJECTORY))).all()


def test_firings_show_the_mass_of_a_resting_stack():
    """Force over acceleration: as well as the force is known, and at rest not at all."""
    changes = {"thrusters": (JET,), "unknown": ["base"]}
    own = build_subject(Config.model_validate(document("both") | changes))
    rest = SHORT.trajectory(motion(size_rad=0.0))
    firing = Firing(thruster="jet", on_s=2.0, for_s=3.0)
    flown = replace(rest, firings=(firing,))
    idle, moved = (sigma(own, foreseen_root(own, t))[0] for t in (rest, flown))
    mass_kg, stack_kg = own.config.bodies["base"].mass_kg, 1500.0
    assert idle > 0.9 * own.scale.prior_sigma[0]
    assert 0.02 * mass_kg < moved < 0.06 * stack_kg
    opened = [block.opened_s[0] for block in foreseen_blocks(own, flown)]
    assert opened[-1] == pytest.approx(3.0, abs=1e-9)
