"""The lines of `fsw identify` about the noise of sensors."""

from offline.identify import noise_text, to_text


def test_a_sensor_with_correlated_noise_has_a_line_and_a_white_one_none():
    counts = {"samples": 32400, "effective_samples": 1560.9}
    white = counts | {"joint": "a", "sigma_nm": 0.05, "correlation_s": 0.0}
    faded = counts | {"joint": "b", "sigma_nm": 0.0503, "correlation_s": 0.0209}
    gyro = counts | {"channel": "gyro", "unit": "rad/s", "sigma": 1e-4, "correlation_s": 0.01}
    assert noise_text({"torque_noise": [white, faded], "inertial_noise": [gyro]}) == [
        "torque noise of b: 0.0503 N m, correlated over 20.9 ms; 32400 samples count as 1561",
        "noise of the gyro: 0.0001 rad/s, correlated over 10 ms; 32400 samples count as 1561",
    ]
    assert noise_text({}) == []


def test_the_noise_of_a_prismatic_joint_is_that_of_a_force():
    noise = {"samples": 100, "effective_samples": 10.0, "joint": "rail", "correlation_s": 0.02}
    assert noise_text({"torque_noise": [noise | {"sigma_n": 1.5}]}) == [
        "force noise of rail: 1.5 N, correlated over 20 ms; 100 samples count as 10"
    ]


def test_little_excitation_names_cures_that_an_arm_on_a_bench_has_too():
    """`fsw excite` plans for a free base alone."""
    result = {"method": "fused", "unknown": ["target"], "reasons": ["INSUFFICIENT_EXCITATION"]}
    result |= {"estimate": {}, "diagnosis": None, "iterations": 1, "wall_s": 1.0}
    cure = to_text(result).splitlines()[1]
    assert "does not show every parameter" not in cure, "each may be measured alone"
    assert all(word in cure for word in ("--reference", "links_sigma_ratio", "fsw excite"))
