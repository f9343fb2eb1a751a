"""Mistakes of configuration in their short form: none leads to a valid estimate that is wrong."""

from dataclasses import replace

import pytest

from evidence.mistakes.command import findings, line, summary
from evidence.mistakes.run import run
from evidence.mistakes.table import mistakes
from hil.world.scenario import ScenarioError

SHORT = (
    *("none", "known base off 20 %", "torque gain of all off 5 %", "all links off 20 %"),
    "prior wrong and tight",
)


@pytest.mark.parametrize("mistake", SHORT)
def test_no_mistake_is_valid_and_wrong(mistake: str) -> None:
    found = run("target", mistake, 0, blocks=70)
    assert not found.confidently_wrong, line(found)
    assert found.outputs > 0, line(found)  # and the robot is still of use


def test_the_right_configuration_converges_though_the_first_steps_lead_to_no_base() -> None:
    """Steps over the consistent bodies settle inside them; the search began elsewhere again."""
    found = run("target", "none", 0, blocks=50)
    assert (found.batch, found.reason) == ("OK", ""), line(found)
    assert found.batch_z < 3.0


def test_windows_that_do_not_fit_are_a_mismatch_and_not_too_few() -> None:
    found = run("target", "sign of joint 2", 0, blocks=50)
    assert (found.batch, found.reason) == ("MODEL_MISMATCH", "MODEL_MISMATCH"), line(found)


def test_a_delay_of_the_inertial_unit_is_not_valid_and_wrong() -> None:
    """Torque and gyro disagree before the residuals show it: the gyro's bias takes it up."""
    found = run("both", "IMU group delay off 20 ms", 0, blocks=40)
    assert found.wrong == 0, line(found)
    assert "PRIOR_CONFLICT" in found.events


def test_a_batch_names_the_lever_arm_that_its_data_contradict() -> None:
    found = run("base", "lever arm off 0.2 m", 0, blocks=100)
    assert found.batch == "PRIOR_CONFLICT", line(found)
    assert "imu.mounting_position_sigma_m" in found.batch_note
    assert not found.confidently_wrong, line(found)


def test_the_figure_can_fail() -> None:
    """Declared as exact, links off by 1 % are enough."""
    assert run("target", "all links off 1 %", 0, blocks=70, exact=True).confidently_wrong


def test_a_recording_that_passes_where_check_says_wrong_fails_the_table() -> None:
    refused = run("target", "quaternion order of the IMU", 0, blocks=1)
    one = replace(refused, refused="", recorded="OK", recorded_z=1.0, findings=("WRONG: signs",))
    assert not one.passed_though_wrong
    assert summary([replace(one, valid=True, batch="OK", batch_z=1.0)])[1]
    passed = replace(one, valid=True, batch="OK", batch_z=1.0, passed=True)
    assert passed.passed_though_wrong
    assert "PASSED THOUGH WRONG" in line(passed)
    assert not summary([passed])[1]


def test_there_are_twenty_mistakes_and_names_are_checked() -> None:
    assert len(mistakes()) > 20
    with pytest.raises(ScenarioError, match="no such"):
        next(findings((), ("no such",), 0, exact=False))
