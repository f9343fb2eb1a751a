"""From truth to what the methods get: noisy channels at the sensors' rate, conditioned.

The paper's sensors give joint angle and torque, base attitude, rate and acceleration. Rates and
accelerations of the joints come from a least-squares spline on the planned motion's own knots; the
other channels, and the base's angular acceleration, from polynomials in short windows, read at
their Gauss-Legendre nodes, where they are uncorrelated: no information counts twice. Every method
gets the same samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from fsw.estimators.samples import JointCurve, Noise, SampleSet
from hil.evidence.methods.exact import base_velocity, true_robot
from hil.evidence.paper.cases import ChannelNoise, scenario_of
from hil.world.environment.wrench import simulate_in
from hil.world.history import TruthHistory, TruthState
from hil.world.inertia import FloatArray
from hil.world.spline import DEGREE, REST_POINTS, JointSpline

STEP_S = 0.01  # of the truth's integration
WINDOW_S = 0.4
NODES = 4
NOISE_STREAM = 131
LEAST_RAD = 1e-9  # of an angle's noise where there is none


class Window(NamedTuple):
    """Least squares in one window: values and slopes at the nodes as linear maps of samples."""

    value: FloatArray  # (m, k)
    slope: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """Exact channels at the sensors' instants and at the nodes."""

    t_s: FloatArray
    sensed: TruthState
    nodes: TruthState


@lru_cache(maxsize=8)
def history_of(orbit: str, system: str, acting: str) -> TruthHistory:
    """Return the truth of the identification motion."""
    scenario = scenario_of(orbit, system, acting)
    spline = JointSpline.load(scenario.identification)
    robot = true_robot(scenario)
    return simulate_in(scenario.environment, robot, spline, 0.0, spline.duration_s, STEP_S)


@lru_cache(maxsize=4)
def channels_of(orbit: str, system: str, acting: str, rate_hz: float) -> Channels:
    """Return the exact channels; sensors sample in the middle of their periods."""
    history = history_of(orbit, system, acting)
    count = int(history.end_s / WINDOW_S) * round(WINDOW_S * rate_hz)
    t_s = np.asarray((np.arange(count) + 0.5) / rate_hz, dtype=np.float64)
    centres = WINDOW_S * (np.arange(int(history.end_s / WINDOW_S)) + 0.5)
    at = legendre.leggauss(NODES)[0]
    nodes = (centres[:, None] + 0.5 * WINDOW_S * at).ravel()
    return Channels(t_s, history.at(t_s), history.at(nodes))


@lru_cache(maxsize=2)
def window(rate_hz: float) -> Window:
    """Return the maps of one window: polynomials of degree NODES - 1."""
    count, half = round(WINDOW_S * rate_hz), 0.5 * WINDOW_S
    inside = ((np.arange(count) + 0.5) / rate_hz - half) / half
    P = np.linalg.pinv(legendre.legvander(inside, NODES - 1))
    at = legendre.leggauss(NODES)[0]
    rows = [legendre.legval(at, legendre.legder(unit)) for unit in np.eye(NODES)]
    slopes = np.stack(rows, axis=1) / half
    return Window(legendre.legvander(at, NODES - 1) @ P, slopes @ P)


def noisy_samples(
    orbit: str, system: str, acting: str, noise: ChannelNoise, rate_hz: float, seed: int
) -> SampleSet:
    """Return the conditioned samples of one draw of noise."""
    channels = channels_of(orbit, system, acting, rate_hz)
    s, at, maps = channels.sensed, channels.nodes, window(rate_hz)
    n = s.q.shape[1]
    draw = _draws(len(s.q), n, seed, shared=noise.shared)
    force = s.a_NB_B - s.g_NB_B  # specific force at the base's origin
    torque = _at_nodes(maps.value, s.tau + noise.torque_nm * draw["torque"])
    rate = s.w_NB_B + noise.rate_rad_s * draw["rate"]
    acceleration = _at_nodes(maps.value, force + noise.acceleration_m_s2 * draw["acceleration"])
    velocity = base_velocity(at)
    spline = JointSpline.load(scenario_of(orbit, system, acting).identification)
    curve, sigma_qdd = _joint_motion(
        spline, channels, s.q + noise.position_rad * draw["position"], noise.position_rad
    )
    value, slope = _gain(maps.value), _gain(maps.slope)
    q, qd, qdd = curve.basis @ curve.coefficients
    turned = _at_nodes(maps.value, noise.attitude_rad * draw["attitude"])
    return SampleSet(
        t_s=at.t_s,
        q=q,
        qd=qd,
        qdd=qdd,
        tau=torque,
        w_NB_B=_at_nodes(maps.value, rate),
        wd_NB_B=_at_nodes(maps.slope, rate),
        a_NB_B=acceleration,
        R_NB=at.R_NB @ Rotation.from_rotvec(turned).as_matrix(),
        v_NB_B=velocity + value * noise.acceleration_m_s2 * draw["velocity"][: len(velocity)],
        curve=curve,
        noise=Noise.of(
            n,
            tau_nm=value * noise.torque_nm,
            qdd_rad_s2=sigma_qdd,
            w_rad_s=value * noise.rate_rad_s,
            wd_rad_s2=slope * noise.rate_rad_s,
            a_m_s2=value * noise.acceleration_m_s2,
            v_m_s=value * noise.acceleration_m_s2,
        ),
    )


def _draws(count: int, n: int, seed: int, *, shared: bool) -> dict[str, FloatArray]:
    """Return unit draws per channel; shared: one sequence on every channel and axis."""
    widths = {
        "position": n,
        "torque": n,
        "rate": 3,
        "acceleration": 3,
        "velocity": 3,
        "attitude": 3,
    }
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(NOISE_STREAM,)))
    if shared:
        one = rng.standard_normal((count, 1))
        return {name: np.repeat(one, width, axis=1) for name, width in widths.items()}
    return {name: rng.standard_normal((count, width)) for name, width in widths.items()}


def _at_nodes(maps: FloatArray, values: FloatArray) -> FloatArray:
    """Apply a window's map (m, k) to samples (N k, c); returns (N m, c)."""
    k = maps.shape[1]
    parts = values.reshape(-1, k, values.shape[1])
    return np.asarray(np.einsum("mk,wkc->wmc", maps, parts).reshape(-1, values.shape[1]))


def _gain(maps: FloatArray) -> float:
    """Return the rms over the nodes of the noise a map lets through."""
    return float(np.sqrt(np.mean(np.sum(maps**2, axis=1))))


def _joint_motion(
    spline: JointSpline, channels: Channels, q: FloatArray, sigma_rad: float
) -> tuple[JointCurve, float]:
    """Return the joints' curve from noisy angles, and 1 sigma of qdd as white noise.

    The errors of the spline's accelerations last for a knot's interval; as white noise of the nodes
    they count times the root of the nodes per coefficient, so that their information counts once.
    """
    at_sensed, at_nodes = _bases(spline, channels)
    coefficients, *_ = np.linalg.lstsq(at_sensed, q, rcond=None)
    root = np.linalg.qr(at_sensed)[1]
    spread = np.linalg.solve(root.T, at_nodes[2].T)
    sigma = sigma_rad * float(np.sqrt(np.mean(np.sum(spread**2, axis=0))))
    repeated = np.sqrt(len(channels.nodes.t_s) / at_sensed.shape[1])
    inverse = np.linalg.solve(root, np.eye(len(root)))
    curve = JointCurve(
        basis=np.stack(at_nodes),
        coefficients=np.asarray(coefficients, dtype=np.float64),
        covariance=max(sigma_rad, LEAST_RAD) ** 2 * inverse @ inverse.T,
    )
    return curve, sigma * float(repeated)


def _bases(spline: JointSpline, channels: Channels) -> tuple[FloatArray, list[FloatArray]]:
    """Return the rest-to-rest spline basis at the sensed times, and with derivatives at nodes."""
    count = len(spline.control_points_rad)
    inner = np.linspace(0.0, spline.duration_s, count - DEGREE + 1)
    ends = np.zeros(DEGREE)
    knots = np.concatenate([ends, inner, ends + spline.duration_s])
    free = np.zeros((count, count - 2 * (REST_POINTS - 1)))
    free[:REST_POINTS, 0] = free[-REST_POINTS:, -1] = 1.0
    for k in range(REST_POINTS, count - REST_POINTS):
        free[k, k - REST_POINTS + 1] = 1.0
    curve = BSpline(knots, free, DEGREE)
    nodes = channels.nodes.t_s
    return curve(channels.t_s), [curve(nodes)] + [curve.derivative(d)(nodes) for d in (1, 2)]
