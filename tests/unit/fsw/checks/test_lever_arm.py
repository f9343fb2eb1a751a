"""A lever arm in millimetres is warned of; a zero in degrees is refused."""

from typing import Any

import pytest

from fsw.checks.configuration import _mounting_warnings
from fsw.config import Config
from tests.support.estimator_cases import make_config


def changed(section: str, **values: Any) -> Config:
    data = make_config().model_dump(mode="json")
    (data["joints"][0] if section == "joints" else data["imu"]["mounting"]).update(values)
    return Config.model_validate(data)


def test_a_lever_arm_of_tens_of_metres_is_warned_of() -> None:
    assert not _mounting_warnings(changed("imu", p_BS_m=[0.1, 0.2, -0.3]))
    (line,) = _mounting_warnings(changed("imu", p_BS_m=[35.0, 0.0, 0.0]))
    assert "imu.mounting.p_BS_m" in line
    with pytest.raises(ValueError, match="p_BS_m"):
        changed("imu", p_BS_m=[350.0, 0.0, 0.0])


@pytest.mark.parametrize("zero_rad", [90.0, -90.0])
def test_a_zero_of_ninety_radians_is_refused(zero_rad: float) -> None:
    with pytest.raises(ValueError, match="zero_offset_rad"):
        changed("joints", zero_offset_rad=zero_rad)
    assert changed("joints", zero_offset_rad=-3.14).joints[0].zero_offset_rad == -3.14
