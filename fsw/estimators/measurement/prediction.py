"""The channels as predicted from joint motion alone, with their derivatives."""

from dataclasses import dataclass
from typing import Literal

from fsw.estimators.measurement.impulse import Impulse
from fsw.messages import FloatArray

CHANNELS = ("torque", "accelerometer", "gyro")
Rate = Literal["momentum", "measured"]


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Predicted channels at m nodes and their Jacobians with respect to the state (p).

    The t torques are those of n joints, then the axes of wrench sensors.
    """

    tau_nm: FloatArray  # (m, t)
    f_m_s2: FloatArray  # (m, 3)
    w_rad_s: FloatArray  # (m, 3)
    J: FloatArray  # (m, t + 6, p): d[tau; f; w]/dx; the next three are its parts
    J_tau: FloatArray  # (m, t, p)
    J_f: FloatArray  # (m, 3, p)
    J_w: FloatArray  # (m, 3, p)
    D_qdd: FloatArray  # (m, t + 3, n): d[tau; f]/d qdd
    D_qd: FloatArray  # (m, t + 6, n): d[tau; f; w]/d qd
    D_w: FloatArray  # (m, t + 3, 3): d[tau; f]/dw
    D_q: FloatArray | None  # (m, t + 6, n): d[tau; f; w]/dq where angles are noisy
    D_carried: FloatArray | None  # (2, m, t + 6, k): d[tau; f; w]/d[h, d/dt h], k are carried
    after: Impulse | None  # momentum gained up to the end
    each: tuple[Impulse | None, ...]  # momentum gained up to the end of each block
    D_start: FloatArray | None = None  # (m, t + 6, 2 c): by c modes at their block's start
    doubt: FloatArray | None = None  # (B, 2 c) variance of these modes not due to the state
