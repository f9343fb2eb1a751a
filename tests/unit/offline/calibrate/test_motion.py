"""The gyro's own delay, to which the star tracker's is measured."""

from offline.calibrate.figures import Figure
from offline.calibrate.motion import gyro_delay


def delay(sensor: str, sigma_s: float) -> Figure:
    return Figure(kind="delay", which=sensor, value=2e-3, sigma=sigma_s, known=5e-3)


def test_a_body_without_joints_has_no_delay_of_its_gyro():
    assert gyro_delay([]) == (0.0, 0.0)
    assert gyro_delay([delay("accelerometer", 1e-4)]) == (0.0, 0.0)


def test_a_delay_counts_where_the_data_measure_it():
    assert gyro_delay([delay("accelerometer", 1e-4), delay("gyro", 2e-4)]) == (2e-3, 2e-4)
    assert gyro_delay([delay("gyro", 5e-3)]) == (0.0, 0.0)
