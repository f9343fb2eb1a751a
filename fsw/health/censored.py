"""Torques beyond their range hide their peaks: what is left of them in a window is too small.

A torque of which samples are missing was beyond its limit then if, next to a gap, it comes within
one of its steps of the limit. Its mean, and every fit to it, is off by what is missing, so the
window does without.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fsw.config import Config
from fsw.messages import ChannelWindow, Window
from fsw.messages.findings import Fault, Finding

NEXT = 1.5  # periods: samples that follow one another are nearer
MISSING = 2  # samples of a window; one is a spike of the wire, and hides nothing


class CensoredTorques:
    """Leaves out the torques of a window whose peaks are missing."""

    def __init__(self, config: Config) -> None:
        rates = {bus.name: bus.rate_hz for bus in config.buses}
        self._joints = [
            (joint.name, joint.torque_limit_nm, rates[joint.bus]) for joint in config.joints
        ]

    def judge(self, window: Window) -> tuple[Window, Sequence[Finding]]:
        """Return the window without these torques, and the findings."""
        span_ns = window.start_ns, window.stop_ns
        joints, findings = list(window.joints), []
        for k, (name, limit_nm, rate_hz) in enumerate(self._joints):
            if _is_censored(joints[k], limit_nm, rate_hz, span_ns):
                values = joints[k].values.copy()
                values[:, 1] = np.nan
                joints[k] = replace(joints[k], values=values)
                text = f"{name}: peaks are missing; its torque is left out of the window"
                findings.append(Finding(window.stop_ns, Fault.TORQUE_RANGE, name, text))
        return (replace(window, joints=tuple(joints)) if findings else window), findings


def _is_censored(
    joint: ChannelWindow, limit_nm: float, rate_hz: float, span_ns: tuple[int, int]
) -> bool:
    known = np.isfinite(joint.values[:, 1])
    torque_nm, (start_ns, stop_ns) = joint.values[known, 1], span_ns
    if not torque_nm.size or torque_nm.size > rate_hz * 1e-9 * (stop_ns - start_ns) - MISSING:
        return False
    steps_ns = np.diff(joint.t_ns[known], prepend=start_ns, append=stop_ns)
    is_gap = steps_ns * rate_hz >= NEXT * 1e9
    step_nm = np.abs(np.diff(torque_nm)[~is_gap[1:-1]]).max(initial=0.0)
    beside_nm = np.abs(torque_nm[is_gap[:-1] | is_gap[1:]]).max(initial=0.0)
    return bool(beside_nm + step_nm > limit_nm)
