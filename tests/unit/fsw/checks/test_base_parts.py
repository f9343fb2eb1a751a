"""Mass and inertia of the base contain every mode and rotor: a body must remain without them."""

from math import sqrt

import pytest

from fsw.checks.configuration import validate
from fsw.config import load
from tests.support.check_cases import assert_named, fault
from tests.unit.fsw.checks.test_actuators import wheel


def tank(**changes):
    return {
        "name": "tank",
        "kind": "slosh",
        "p_B_m": [0.1, 0.0, -0.3],  # the base's centre of mass
        "mass_kg": 25.0,
        "frequency_hz": 0.5,
        "damping_ratio": 0.01,
        "amplitude_m": 0.005,
    } | changes


def panel(**changes):
    return {
        "name": "panel",
        "kind": "panel",
        "p_B_m": [0.1, 0.0, -0.3],
        "axes_B": [[1.0, 0.0, 0.0]],
        "mass_kg": 25.0,
        "inertia_kg_m2": [20.0, 0.0, 0.0, 20.0, 0.0, 4.0],
        "frequency_hz": 0.5,
        "damping_ratio": 0.01,
        "amplitude_rad": 0.005,
    } | changes


def one_line(arm, *words):
    message = fault(arm)
    assert len(message.splitlines()) == 1
    assert_named(message, *words)


def test_a_mode_heavier_than_the_base_is_one_line(arm):
    arm.data["modes"] = [tank(mass_kg=500.0)]
    one_line(arm, "modes.0.mass_kg: 500 (tank)", "of 200 kg", "must be below 200")


def test_modes_that_are_heavier_than_the_base_together_are_one_line(arm):
    arm.data["modes"] = [tank(name=f"tank{k}", mass_kg=90.0) for k in range(3)]
    one_line(arm, "modes.2.mass_kg: 90 (tank2)", "of 200 kg", "must be below 20")


def test_a_mode_is_judged_against_the_base_that_is_given(arm):
    arm.data["modes"] = [tank(mass_kg=150.0)]
    validate(load(arm.write()))
    sigma = {"mass_kg": 10.0, "com_m": [0.1] * 3, "inertia_kg_m2": [5.0] * 6}
    base = {"mass_kg": 120.0, "com_m": [0.1, 0.0, -0.3], "sigma": sigma}
    arm.data["bodies"]["base"] = base | {"inertia_kg_m2": [60.0, 0.0, 0.0, 50.0, 0.0, 40.0]}
    for unknown in (["target"], ["base"]):
        arm.data["unknown"] = unknown
        one_line(arm, "modes.0.mass_kg: 150 (tank)", "of 120 kg")


def test_a_mode_farther_out_than_the_base_s_inertia_allows_is_one_line(arm):
    """Without 25 kg at d along x from the centre of 200 kg, moments y and z lose 200/7 d^2.

    The rest is a body as long as that along x is below the sum of the others: 60 < 90 - 400/7 d^2.
    """
    limit_m = sqrt((90.0 - 60.0) * 7.0 / 400.0)
    arm.data["modes"] = [tank(p_B_m=[0.1 + 0.99 * limit_m, 0.0, -0.3])]
    validate(load(arm.write()))
    arm.data["modes"] = [tank(p_B_m=[0.1 + 1.01 * limit_m, 0.0, -0.3])]
    one_line(arm, "modes.0.mass_kg: 25 (tank)", "p_B_m", "principal moments", "sum of the other")


def test_a_panel_with_more_inertia_than_the_base_is_one_line(arm):
    arm.data["modes"] = [panel()]
    validate(load(arm.write()))
    arm.data["modes"] = [panel(inertia_kg_m2=[70.0, 0.0, 0.0, 70.0, 0.0, 4.0])]
    one_line(arm, "modes.0.mass_kg: 25 (panel)", "principal moments [-", "must be positive")


@pytest.mark.parametrize(("inertia_kg_m2", "is_sound"), [(43.5, True), (43.7, False)])
def test_a_rotor_with_more_inertia_than_the_base_is_one_line(arm, inertia_kg_m2, is_sound):
    """About [0, 0.6, 0.8] the base has 50 * 0.36 + 40 * 0.64 kg m^2 = 43.6."""
    arm.data["wheels"] = [wheel(inertia_kg_m2=inertia_kg_m2)]
    arm.data["estimator"] = {"momentum_sigma_nms": 5.0}
    if is_sound:
        validate(load(arm.write()))
    else:
        one_line(arm, "wheels.0.inertia_kg_m2: 43.7 (wheel1)", "must be below", "43.6")
