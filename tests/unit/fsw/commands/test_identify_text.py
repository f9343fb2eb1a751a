"""The lines of `fsw identify` about the noise of torque sensors."""

from fsw.commands.identify import noise_text


def test_a_sensor_with_correlated_noise_has_a_line_and_a_white_one_none():
    white = {"joint": "a", "sigma_nm": 0.05, "correlation_s": 0.0}
    faded = {"joint": "b", "sigma_nm": 0.0503, "correlation_s": 0.0209}
    counts = {"samples": 32400, "effective_samples": 1560.9}
    assert noise_text([white | counts, faded | counts]) == [
        "torque noise of b: 0.0503 N m, correlated over 20.9 ms; 32400 samples count as 1561"
    ]
