"""Values of housekeeping sets from plain values of the loop's summary."""

from fsw.config.telemetry import JOINT_SLOTS
from fsw.telemetry.state.values import device_values

MOTOR = {"velocity_rad_s": 0.5, "motor_torque_ratio": -0.25, "temperature_degc": 21.5}


def test_the_motor_side_of_a_joint_has_the_slot_of_its_place_in_the_configuration():
    values = device_values({"joints": {"elbow": MOTOR}}, ["arm"], ["shoulder", "elbow"], {})
    assert values["joint_1_motor_present"] is False
    assert values["joint_2_motor_present"] is True
    assert values["joint_2_velocity"] == MOTOR["velocity_rad_s"]
    for word in ("motor_torque_ratio", "temperature_degc"):
        assert values[f"joint_2_{word}"] == MOTOR[word]
    assert values[f"joint_{JOINT_SLOTS}_motor_present"] is False


def test_before_the_first_summary_nothing_is_present():
    values = device_values({}, ["arm"], ["shoulder"], {})
    assert (values["bus1_up"], values["joint_1_motor_present"]) == (False, False)


def test_a_sensor_without_a_line_is_up_if_its_bus_is():
    status = {"links": {"arm": {"up": True, "losses": 2}, "star_tracker": {"up": True}}}
    values = device_values(status, ["arm"], [], {"imu": "arm"})
    assert (values["imu_up"], values["imu_losses"]) == (True, 2)
    assert (values["star_tracker_up"], values["star_tracker_losses"]) == (True, 0)
