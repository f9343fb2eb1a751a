import numpy as np
import pytest

from fsw.drivers.sources.clock_model import SPAN_S, ClockModel

TICK_S = 1 / 2000
T0 = 7 * 10**15


def fed(ppm: float, seconds: float, delay_ns: np.ndarray, jump_s: float = 0.0) -> ClockModel:
    model = ClockModel(TICK_S, 200.0)
    count = int(500 * seconds)
    for k in range(count):
        late = jump_s * 1e9 if k > count // 2 else 0.0
        t_ns = 2e6 * k * (1 + 1e-6 * ppm) + delay_ns[k % len(delay_ns)] + late
        model.observe(4 * k, T0, t_ns)
    return model


def error_ns(model: ClockModel, k: int, ppm: float) -> float:
    reference_ns, rest_ns = model.predict_ns(4 * k)
    return (reference_ns - T0) + rest_ns - 2e6 * k * (1 + 1e-6 * ppm)


@pytest.mark.parametrize("ppm", [-50.0, 0.0, 50.0, 150.0])
def test_offset_and_rate_are_those_of_the_earliest_arrivals(ppm: float) -> None:
    delay_ns = np.random.default_rng(1).exponential(300e3, 4999)
    model = fed(ppm, 30.0, delay_ns)
    assert abs(error_ns(model, 15_000, ppm)) < 20e3
    assert model.rate_error_ppm == pytest.approx(ppm, abs=3.0)
    assert model.device_time(T0 + 1e9) == pytest.approx(2000 / (1 + 1e-6 * ppm), abs=0.1)


def test_no_rate_is_fitted_to_less_than_half_a_second() -> None:
    assert fed(50.0, 0.4, np.zeros(1)).rate_error_ppm == 0.0


def test_the_rate_never_leaves_its_tolerance() -> None:
    assert fed(900.0, 5.0, np.zeros(1)).rate_error_ppm == pytest.approx(200.0)


def test_a_jump_of_the_unit_is_followed_after_a_second() -> None:
    model = fed(0.0, 20.0, np.zeros(1), jump_s=0.03)
    assert error_ns(model, 9_999, 0.0) == pytest.approx(30e6, abs=1e3)


def test_memory_is_bounded() -> None:
    model = fed(50.0, 3 * SPAN_S, np.random.default_rng(2).exponential(1e5, 997))
    assert len(model._points) <= SPAN_S / 0.25 + 2
    assert len(model._hull) <= len(model._points)
