"""Physical constants, each with its source."""

EARTH_GRAVITY_PARAMETER_M3_S2 = 3.986004418e14  # WGS 84 (NIMA TR8350.2, 2000), with the atmosphere
STANDARD_GRAVITY_M_S2 = 9.80665  # by definition (3rd CGPM, 1901)
