"""Which columns of a table `fsw init` takes for positions and torques."""

import pytest

from offline.init.columns import joint_groups, positions_and_torques


@pytest.mark.parametrize(
    ("stems", "position", "torque"),
    [
        (("q", "tau", "current"), "q", "tau"),
        (("q", "iq"), "q", "iq"),
        (("joint_position", "joint_current"), "joint_position", "joint_current"),
        (("position", "current_position"), "position", None),
        (("angle", "current_angle"), "angle", None),
    ],
)
def test_currents_stand_for_torques_but_the_current_angle_does_not(stems, position, torque):
    columns = [f"{stem}_{k}" for stem in stems for k in (1, 2)]
    found = positions_and_torques(joint_groups(columns, ["a", "b"]))
    wanted = [name and (f"{name}_1", f"{name}_2") for name in (position, torque)]
    assert [group and group.columns for group in found] == wanted
