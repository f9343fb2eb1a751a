"""Check whether a block can be the motion of a spacecraft with an arm at all."""

import numpy as np

from fsw.messages import Block

LIMITS = {
    "q_rad": 1e4,
    "qd_rad_s": 1e2,
    "qdd_rad_s2": 1e5,
    "tau_nm": 1e5,
    "w_NB_B_rad_s": 1e2,
    "wd_NB_B_rad_s2": 1e5,
    "f_NS_B_m_s2": 1e4,
    "R_NB": 2.0,
    "cov_joint": 1e12,
    "cov_tau": 1e12,
    "cov_gyro": 1e12,
    "cov_acc": 1e12,
    "tau_products_nm2": 1e10,
    "imu_products": 1e10,
    "carried_nms": 1e6,
    "carried_nm": 1e5,
    "cov_carried": 1e12,
    "edges": 1e3,
    "opened_s": 1e9,
    "walk_rad2": 1e8,
}  # far beyond any machine of this kind, and far from overflow


def plausible(block: Block) -> bool:
    """Return whether every value is finite and within the widest physical limits."""
    return all(
        bool((np.abs(getattr(block, name)) <= limit).all()) for name, limit in LIMITS.items()
    )
