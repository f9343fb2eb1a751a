"""Reaction wheels: what is in doubt of each."""

from fsw.estimators.model.state_group import StateGroup, per_part

SCALE = StateGroup(  # relative error of each wheel's axial inertia
    name="wheel_scale",
    effect="inertia of wheels",
    unit="",
    key="wheels[].inertia_sigma_ratio",
    prior=per_part("wheels", "inertia_sigma_ratio"),
    is_calibration=True,
    mistake="axial inertia of wheels",
)
DELAY = StateGroup(  # true delay less the configured one
    name="wheel_delay",
    effect="delay of wheels",
    unit="s",
    key="wheels[].delay_sigma_s",
    prior=per_part("wheels", "delay_sigma_s"),
    is_calibration=True,
)
