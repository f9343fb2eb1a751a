"""Constants of the orbital environment, each with its source."""

EARTH_GM_M3_S2 = 3.986004418e14  # IERS Conventions (2010), table 1.1
SUN_GM_M3_S2 = 1.32712442099e20  # IERS Conventions (2010), table 1.1
MOON_GM_M3_S2 = 4.902800066e12  # IERS Conventions (2010), table 1.1: mu times the Earth's
EARTH_RADIUS_M = 6_378_137.0  # WGS 84
EARTH_RATE_RAD_S = 7.292115e-5  # WGS 84
AU_M = 149_597_870_700.0  # IAU 2012 resolution B2
SOLAR_PRESSURE_PA = 4.54e-6  # at 1 AU: 1361 W/m^2 (Kopp and Lean 2011) over the speed of light
GAS_CONSTANT_J_MOL_K = 8.314462618  # CODATA 2018
