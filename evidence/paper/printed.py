"""The figures printed in the paper of Rackl, Lampariello, Albu-Schaeffer (IFAC ACA 2013)."""

from collections.abc import Mapping

METRICS = ("mean_position_m", "max_position_m", "mean_angle_rad", "max_angle_rad")
METRIC_TITLES: Mapping[str, str] = {
    "mean_position_m": "mean position error [m] (Table 4)",
    "max_position_m": "max position error [m] (Table 5)",
    "mean_angle_rad": "mean orientation error [rad] (Table 6)",
    "max_angle_rad": "max orientation error [rad] (Table 7)",
}
# Tables 4-7: end-effector error with noise and LEO disturbances, by metric, method and system.
# Two maxima are printed smaller than their means: RDA base position, and CM both angle.
PRINTED: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    "mean_position_m": {
        "mrnea": {"base": 0.0054, "target": 0.0269, "both": 0.0399},
        "rda": {"base": 0.0108, "target": 0.0150, "both": 0.0601},
        "cm": {"base": 0.0495, "target": 0.0342, "both": 0.1021},
        "ce": {"base": 0.0392, "target": 0.0360, "both": 0.1152},
    },
    "max_position_m": {
        "mrnea": {"base": 0.0186, "target": 0.1247, "both": 0.0987},
        "rda": {"base": 0.0044, "target": 0.0704, "both": 0.1003},
        "cm": {"base": 0.0923, "target": 0.1565, "both": 0.2087},
        "ce": {"base": 0.0787, "target": 0.1661, "both": 0.1961},
    },
    "mean_angle_rad": {
        "mrnea": {"base": 0.0213, "target": 0.0271, "both": 0.0567},
        "rda": {"base": 0.0194, "target": 0.0163, "both": 0.0657},
        "cm": {"base": 0.0413, "target": 0.0328, "both": 0.1954},
        "ce": {"base": 0.0434, "target": 0.0343, "both": 0.0978},
    },
    "max_angle_rad": {
        "mrnea": {"base": 0.0671, "target": 0.0658, "both": 0.3419},
        "rda": {"base": 0.0620, "target": 0.0391, "both": 0.1892},
        "cm": {"base": 0.1421, "target": 0.0804, "both": 0.1624},
        "ce": {"base": 0.439, "target": 0.0843, "both": 0.1899},
    },
}
# Best printed figures, without RDA's maximum of 4.4 mm, which is smaller than its mean.
BEST: Mapping[str, Mapping[str, float]] = {
    "mean_position_m": {"base": 0.0054, "target": 0.0150, "both": 0.0399},
    "max_position_m": {"base": 0.0186, "target": 0.0704, "both": 0.0987},
}
BETTER_BY = 20.0
# Tables 2 and 3: RDA, target in LEO: m [kg], c [m], then Ixx Ixy Ixz Iyy Iyz Izz [kg m2].
TABLE_2 = (398.9, 0.781, 0.502, 0.419, 259.25, 9.54, 10.14, 249.21, 5.32, 253.42)
TABLE_3 = (419.2, 0.821, 0.597, 0.448, 267.19, 12.00, 2.36, 254.58, -15.47, 261.95)
PARAMETERS = ("m", "cx", "cy", "cz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
