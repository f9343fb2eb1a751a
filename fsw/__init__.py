"""Flight software: the onboard inertial-parameter estimator of a free-floating space robot."""
