"""The short form of `hil calibration`: one seed of wrong sensors, every figure within its bound."""

import numpy as np
import pytest

from evidence.calibration.case import BOUND_SIGMAS, Case, judged, work
from evidence.calibration.command import summary

SEED = 3


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["rest", "motion"])
def test_every_measured_figure_of_a_seed_is_within_the_bound(mode):
    case = Case("table_target", mode, SEED)
    rows = summary(("table_target", mode), [work(case)[str(case)]])
    by_kind = {row["kind"]: row for row in rows}
    assert [row for row in rows if row["beyond"]] == []
    assert by_kind["torque_offset"]["measured"] >= 1
    if mode == "motion":
        assert by_kind["torque_scale"]["measured"] == 7
        assert by_kind["imu_angle"]["measured"] == 3
        assert by_kind["imu_place"]["refused"] == 1  # along the table's normal nothing shows it
        assert by_kind["delay.gyro"]["measured"] == by_kind["delay.star_tracker"]["measured"] == 1


def test_a_figure_off_by_more_than_the_bound_is_counted_unless_it_was_refused():
    figure = {"name": "torque_offset.joint1", "value": 0.1, "sigma": 0.01, "unit": "N m"}
    off = judged(figure | {"verdict": "measured"}, {"torque_offset.joint1": 0.06})
    assert off["off_sigmas"] == pytest.approx(4.0)
    refused = off | {"verdict": "prior-dominated"}
    (row,) = summary(("s", "rest"), [{"figures": [off, refused]}])
    assert (row["measured"], row["refused"], row["beyond"]) == (1, 1, 1)
    assert row["worst_sigmas"] == pytest.approx(4.0)
    assert np.float64(BOUND_SIGMAS) == 3.0
