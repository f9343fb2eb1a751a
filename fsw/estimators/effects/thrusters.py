"""Thrusters: what is in doubt of each."""

from fsw.estimators.model.state_group import StateGroup, per_part

FORCE = StateGroup(  # relative error of each thruster's force
    name="thrust_scale",
    effect="force of thrusters",
    unit="",
    key="thrusters[].force_sigma_ratio",
    cause="thrusters",
    prior=per_part("thrusters", "force_sigma_ratio"),
    is_calibration=True,
    shared=0.5,  # one supply pressure
    mistake="force_n of thrusters",
)
DELAY = StateGroup(  # true delay less the configured one
    name="thrust_delay",
    effect="delay of thrusters",
    unit="s",
    key="thrusters[].delay_sigma_s",
    cause="thrusters",
    prior=per_part("thrusters", "delay_sigma_s"),
    is_calibration=True,
    mistake="delay_s of thrusters",
)
RISE = StateGroup(  # true rise time less the configured one
    name="thrust_rise",
    effect="rise of thrusters",
    unit="s",
    key="thrusters[].rise_sigma_s",
    cause="thrusters",
    prior=per_part("thrusters", "rise_sigma_s"),
    is_calibration=True,
    mistake="rise_s of thrusters",
)
