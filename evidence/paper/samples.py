"""The data of the methods: noisy channels of the truth at the sensors' rate, conditioned.

The paper's sensors give joint angle and torque, base attitude, rate and acceleration. The flight
conditioner makes blocks of these channels. But rates and accelerations of the joints come from a
least-squares spline on the knots of the planned motion (`motion`): with the paper's noise of the
angles, short windows cannot give them. Every method gets the same blocks.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from evidence.methods.exact import base_velocity, true_robot
from evidence.methods.sensed import ChannelNoise, condition, declared, draws, sensed, with_noise
from evidence.paper.cases import scenario_of
from evidence.paper.motion import JointCurve, fit_curve
from fsw.config import Config
from fsw.messages import Block
from hil.world.history import TruthHistory, TruthState
from hil.world.inertia import FloatArray
from hil.world.simulation import simulate_in
from hil.world.spline import JointSpline

STEP_S = 0.01  # step of the integration
WINDOW_S = 0.4
NODES = 4
NOISE_STREAM = 131


@dataclass(frozen=True, slots=True, eq=False)
class Conditioned:
    """The data of the methods for one draw of noise."""

    blocks: list[Block]  # with the joint motion of the curve, which counts as exact
    curve: JointCurve
    velocity_m_s: Mapping[int, FloatArray]  # (m, 3) of the base's origin in B, by block index
    velocity_sigma_m_s: float  # 1 sigma of the velocity


@lru_cache(maxsize=8)
def history_of(orbit: str, system: str, acting: str) -> TruthHistory:
    """Return the simulated truth of the identification motion."""
    scenario = scenario_of(orbit, system, acting)
    spline = JointSpline.load(scenario.identification)
    robot = true_robot(scenario)
    return simulate_in(scenario.environment, robot, spline, 0.0, spline.duration_s, STEP_S)


@lru_cache(maxsize=4)
def state_of(orbit: str, system: str, acting: str, rate_hz: float) -> TruthState:
    """Return the true states at the samples, which are in the middle of the sample periods."""
    history = history_of(orbit, system, acting)
    count = int(history.end_s / WINDOW_S) * round(WINDOW_S * rate_hz)
    return history.at(np.asarray((np.arange(count) + 0.5) / rate_hz, dtype=np.float64))


def conditioned(
    orbit: str,
    system: str,
    acting: str,
    noise: ChannelNoise,
    rate_hz: float,
    seed: int,
    config: Config,
) -> Conditioned:
    """Return the data of one draw of noise, of sensors that are mounted as configured."""
    state = state_of(orbit, system, acting, rate_hz)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(NOISE_STREAM,)))
    unit = draws(len(state.q), state.q.shape[1], rng, shared=noise.shared)
    settings = declared(config, noise, rate_hz, window_s=WINDOW_S, nodes=NODES)
    channels = with_noise(sensed(state, settings), noise, unit)
    blocks = condition(channels, settings, rate_hz)
    nodes_s = np.concatenate([block.t_ns for block in blocks]) * 1e-9
    spline = JointSpline.load(scenario_of(orbit, system, acting).identification)
    curve = fit_curve(spline, state.t_s, channels.q_rad, nodes_s, noise.position_rad)
    sigma = float(np.sqrt(np.mean(np.diag(blocks[0].cov_acc))))  # equal to an acceleration's
    at = history_of(orbit, system, acting).at(nodes_s)
    velocity = base_velocity(at) + sigma * unit["velocity"][: len(nodes_s)]
    return Conditioned(
        blocks=curve.blocks(blocks),
        curve=curve,
        velocity_m_s={b.index: velocity[i * NODES : (i + 1) * NODES] for i, b in enumerate(blocks)},
        velocity_sigma_m_s=sigma,
    )
