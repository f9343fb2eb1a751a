"""Sensor models: the values that each device measures, with errors, before they become bytes.

Frames: N inertial, B base, S sensor; `R_NB` maps B components to N. Each device has its own random
streams, spawned from the run's seed, so a change of one device leaves the noise of others equal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from hil.devices.truth_port import FloatArray, State
from hil.world.friction import draw_friction
from hil.world.motor_side import draw_motor_side
from hil.world.noise import Hysteresis, NoiseStream
from hil.world.sensor_config import (
    ImuSensorConfig,
    JointSensorConfig,
    Quaternion,
    StarTrackerSensorConfig,
    Vector3,
)

DEVICE_KEYS = {"bus": 0, "joint": 1, "imu": 2, "star_tracker": 3, "host": 4, "line": 5}
DEVICE_KEYS |= {"wheel": 6, "thruster": 7, "mode": 8, "feed": 9, "cyclic": 10}
HYSTERESIS_WIDTH_RATIO = 0.05  # of full scale: half the torque from one branch to the other


def generator(seed: int, device: str, index: int = 0, stream: int = 0) -> np.random.Generator:
    """Return the random stream of one device; `stream` is the number of the purpose."""
    key = (DEVICE_KEYS[device], index, stream)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


@dataclass(slots=True)
class NormalStream:
    """Standard normal rows, drawn in batches; the batch size does not change the sequence."""

    rng: np.random.Generator
    width: int
    batch: int = 256
    _rows: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    _next: int = 0

    def draw(self) -> FloatArray:
        """Return the next row, shape (width,)."""
        if self._next >= len(self._rows):
            self._rows = self.rng.standard_normal((self.batch, self.width))
            self._next = 0
        self._next += 1
        row: FloatArray = self._rows[self._next - 1]
        return row


class Fading:
    """Turns white noise into exponentially correlated noise of the same sigma."""

    def __init__(self, time_s: float, rate_hz: float, width: int) -> None:
        self._ratio = math.exp(-1.0 / (time_s * rate_hz)) if time_s > 0.0 else 0.0
        self._last = np.zeros(width)

    def of(self, white: FloatArray) -> FloatArray:
        """Return the next samples (k, width); with correlation time 0 they are `white`."""
        if not self._ratio:
            return white
        from scipy.signal import lfilter  # the import lasts 0.3 s

        fresh = math.sqrt(1.0 - self._ratio**2) * white
        start = self._ratio * self._last
        faded, _ = lfilter([1.0], [1.0, -self._ratio], fresh, axis=0, zi=start[None])
        self._last = faded[-1]
        return np.asarray(faded)


class JointErrors:
    """Encoder and torque sensor errors of n joints, drawn joint by joint."""

    def __init__(
        self,
        config: JointSensorConfig,
        n: int,
        seed: int,
        rate_hz: float = 500.0,
        sliding: Sequence[bool] = (),
    ) -> None:
        """Draw the errors; `sliding`: which joints are prismatic, empty: none."""
        draws = [generator(seed, "joint", i, 1).standard_normal(2) for i in range(n)]
        self.config = config
        self.torque_offset_nm = config.torque_offset_sigma_nm * np.array([d[0] for d in draws])
        self.torque_scale = 1.0 + config.torque_scale_error_ratio * np.array([d[1] for d in draws])
        self.friction = draw_friction(
            generator(seed, "joint", 0, 2),
            n,
            coulomb_sigma_nm=config.friction_coulomb_sigma_nm,
            viscous_sigma_nms_rad=config.friction_viscous_sigma_nms_rad,
        )
        self.motor_side = draw_motor_side(
            generator(seed, "joint", 0, 4),
            n,
            rotor_inertia_sigma_kg_m2=config.rotor_inertia_sigma_kg_m2,
            ripple_sigma_nm=config.ripple_sigma_nm,
            ripple_periods=config.ripple_periods,
        )
        self._streams = [generator(seed, "joint", i, 0) for i in range(n)]
        self._blocks = [
            None if noise is None else NoiseStream(noise, rate_hz, n, seed, channel)
            for channel, noise in enumerate((config.position_noise, config.torque_noise))
        ]
        sigmas = (config.encoder_noise_rad, config.torque_noise_nm)
        self._sigmas = [
            sigma if block is None else 1.0
            for sigma, block in zip(sigmas, self._blocks, strict=True)
        ]
        self._fading = Fading(config.torque_noise_correlation_s, rate_hz, n)
        units = np.where(sliding, 1.0, math.tau) if len(sliding) else math.tau
        self._step_rad = units / 2**config.encoder_bits
        size_nm = config.torque_hysteresis_ratio * config.rated_torque_nm
        width_nm = HYSTERESIS_WIDTH_RATIO * config.rated_torque_nm
        self._hysteresis = Hysteresis(size_nm, width_nm, n) if size_nm > 0 else None
        self._noise = np.empty((0, 2, n))  # of the next latches: position, torque
        self.speed_only = np.array([node.encoder == "speed" for node in config.nodes], bool)
        self._of_speed = [
            generator(seed, "joint", i, 3) for i in np.flatnonzero(self.speed_only).tolist()
        ]
        self._speed_noise = np.empty((0, len(self._of_speed)))
        self._next = 0

    def _refill(self) -> None:
        rows = np.stack([s.standard_normal((256, 2)) for s in self._streams], axis=2)
        for column, block in enumerate(self._blocks):
            if block is not None:
                rows[:, column] = block.take(256)
            rows[:, column] *= self._sigmas[column]
        rows[:, 1] = self._fading.of(rows[:, 1])
        self._noise, self._next = rows, 0
        if self._of_speed:
            white = [stream.standard_normal(256) for stream in self._of_speed]
            self._speed_noise = self.config.speed_noise_rad_s * np.stack(white, axis=1)

    def left(self) -> int:
        """Return how many latches can be measured ahead: one if there is hysteresis."""
        if self._next >= len(self._noise):
            self._refill()
        return 1 if self._hysteresis is not None else len(self._noise) - self._next

    def ahead(
        self, q: FloatArray, qd: FloatArray, tau: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return measured position [rad], quantised, and link torque [N m] of the next latches.

        Parameters
        ----------
        q, qd, tau : (k, n) true position [rad], rate [rad/s], torque [N m]; k at most `left`

        Call `use` for each latch that is needed; the next call returns the other errors again.
        """
        noise = self._noise[self._next : self._next + len(q)]
        step_rad = self._step_rad
        position = np.rint((q + noise[:, 0]) / step_rad) * step_rad
        torque = (tau + self.friction.torque_nm(qd)) * self.torque_scale + self.torque_offset_nm
        if self._hysteresis is not None:
            torque = torque + self._hysteresis.error_nm(tau[0])
        return position, torque + noise[:, 1]

    def speeds_ahead(self, qd: FloatArray) -> FloatArray:
        """Return the speeds [rad/s] that encoders without position measure at the next latches.

        Parameters
        ----------
        qd : (k, n) true rates [rad/s]; the same k latches as in the call of `ahead`

        Returns
        -------
        (k, m) speeds of the m joints where `speed_only` is true
        """
        own = qd[:, np.flatnonzero(self.speed_only)]
        return np.asarray(own + self._speed_noise[self._next : self._next + len(qd)])

    def use(self) -> None:
        """Count one latch as measured."""
        self._next += 1

    def measure(
        self, q: FloatArray, qd: FloatArray, tau: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return measured position [rad], quantised, and link torque [N m] of one latch, (n,)."""
        self.left()
        position, torque = self.ahead(q[None], qd[None], tau[None])
        self.use()
        return position[0], torque[0]


class ImuErrors:
    """Noise and bias of the inertial unit, sample by sample in order."""

    def __init__(self, config: ImuSensorConfig, seed: int) -> None:
        turn_on = generator(seed, "imu", 0, 1).standard_normal(6)
        self.gyro_bias_rad_s: FloatArray = config.gyro_bias_sigma_rad_s * turn_on[:3]
        self.gyro_bias_rad_s = self.gyro_bias_rad_s + config.gyro_bias_S_rad_s
        self.acc_bias_m_s2: FloatArray = config.acc_bias_sigma_m_s2 * turn_on[3:]
        self.acc_bias_m_s2 = self.acc_bias_m_s2 + config.acc_bias_S_m_s2
        root_rate = math.sqrt(config.rate_hz)
        self._sigma = np.repeat(
            [
                config.angle_random_walk_rad_sqrt_s * root_rate,
                config.velocity_random_walk_m_s_sqrt_s * root_rate,
            ],
            3,
        )
        walks = [config.gyro_bias_walk_rad_s_sqrt_s, config.acc_bias_walk_m_s2_sqrt_s]
        self._walk = np.repeat(walks, 3) / root_rate
        self._white = generator(seed, "imu", 0, 0)
        self._drift = generator(seed, "imu", 0, 2)
        self._bias = np.concatenate([self.gyro_bias_rad_s, self.acc_bias_m_s2])
        self._fading = Fading(config.noise_correlation_s, config.rate_hz, 6)
        self._blocks = [
            None if noise is None else NoiseStream(noise, config.rate_hz, 3, seed, 2 + channel)
            for channel, noise in enumerate((config.gyro_noise, config.acc_noise))
        ]

    def next(self, count: int) -> FloatArray:
        """Return the next `count` errors, columns gyro [rad/s] 3, accelerometer [m/s^2] 3."""
        white = self._fading.of(self._sigma * self._white.standard_normal((count, 6)))
        for channel, block in enumerate(self._blocks):
            if block is not None:
                white[:, 3 * channel : 3 * channel + 3] = block.take(count)
        steps = self._walk * self._drift.standard_normal((count, 6))
        bias: FloatArray = self._bias + np.cumsum(steps, axis=0)
        self._bias = bias[-1]
        return bias + white


def rotation_of(q_xyzw: Quaternion) -> FloatArray:
    """Return the rotation matrix of a unit quaternion."""
    matrix: FloatArray = Rotation.from_quat(q_xyzw).as_matrix()
    return matrix


def angular_rate(state: State, R_BS: FloatArray) -> FloatArray:
    """Return w_NS_S [rad/s], shape (k, 3)."""
    rate: FloatArray = state.w_NB_B @ R_BS
    return rate


def specific_force(
    state: State,
    p_BS_m: Vector3,
    R_BS: FloatArray,
    reading: Literal["specific_force", "kinematic"] = "specific_force",
) -> FloatArray:
    """Return f_NS_S [m/s^2], shape (k, 3): the specific force at p_BS.

    f = R_SB (a + wd x r + w x (w x r) - g(r)), a the classical acceleration of the base origin and
    g gravity at the sensor's place. "kinematic" leaves g out, which no real sensor does.
    """
    r = np.asarray(p_BS_m)
    w = state.w_NB_B
    force: FloatArray = state.a_NB_B + np.cross(state.wd_NB_B, r) + np.cross(w, np.cross(w, r))
    if reading == "specific_force":
        force = force - state.g_NB_B - state.gradient_B @ r
    return np.asarray(force @ R_BS)


def attitude(
    R_NB: FloatArray, config: StarTrackerSensorConfig, normal: FloatArray
) -> tuple[float, float, float, float]:
    """Return the reported quaternion w x y z of one exposure; `normal`: 3 standard normal draws.

    The noise is a small rotation about the tracker's own axes, z the boresight.
    """
    R_SN = rotation_of(config.q_BS_xyzw).T @ R_NB.T
    sigma = np.array([config.noise_across_rad, config.noise_across_rad, config.noise_about_rad])
    if config.attitude_noise is not None:
        sigma = np.full(3, config.attitude_noise.sigma(config.rate_hz))
    measured = Rotation.from_rotvec(sigma * normal) * Rotation.from_matrix(R_SN)
    if config.rotation == "tracker_to_inertial":
        measured = measured.inv()
    x, y, z, w = measured.as_quat()
    return float(w), float(x), float(y), float(z)
