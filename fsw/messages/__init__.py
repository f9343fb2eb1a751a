"""Typed values that cross module boundaries. SI units; times are monotonic nanoseconds.

Frames: N inertial, B spacecraft bus (base body), S sensor, E tool. `R_NB` takes B components to N.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
MAX_EVENT_TEXT = 1000  # characters
CARRIED = ("carried_nms", "carried_nm", "cov_carried")  # momentum of k parts of the base
# fields of a block; absent if the last one is empty
PARTS = (CARRIED, ("edges", "opened_s"), ("walk_rad2",))
MOST_EDGES = 48  # most changes of valves that a block holds


IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class JointSamples:
    """Latched positions and link-side torques of joint nodes (TPDO1), in order of arrival.

    A joint with `encoder: speed` has its speed [rad/s] in place of the position.
    """

    t_ns: IntArray  # (k,) time of validity: stamp of the SYNC that latched it, plus latch offset
    t_receive_ns: IntArray  # (k,)
    joint: IntArray  # (k,) index in the configured joint list
    position_rad: FloatArray  # (k,) calibrated: sign and zero offset applied
    torque_nm: FloatArray  # (k,) calibrated: sign, gain and offset applied; NaN: sensor at fault

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t_ns)


@dataclass(frozen=True, slots=True, eq=False)
class ImuSamples:
    """Samples of an inertial unit; gyro and accelerometer have different times (group delays)."""

    t_gyro_ns: IntArray  # (k,)
    t_acc_ns: IntArray  # (k,)
    t_receive_ns: IntArray  # (k,)
    w_NS_S_rad_s: FloatArray  # (k, 3), NaN: cluster not usable
    f_NS_S_m_s2: FloatArray  # (k, 3) specific force, NaN: cluster not usable

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t_gyro_ns)


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeSamples:
    """Star-tracker solutions, converted to attitudes of the spacecraft bus B."""

    t_ns: IntArray  # (k,)
    t_receive_ns: IntArray  # (k,)
    q_NB_xyzw: FloatArray  # (k, 4)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t_ns)


@dataclass(frozen=True, slots=True, eq=False)
class DeviceSamples:
    """Samples of the devices of one section of the configuration, in order of arrival."""

    section: str  # a list of the configuration, see `Config.devices`
    t_ns: IntArray  # (k,) time of validity
    t_receive_ns: IntArray  # (k,)
    device: IntArray  # (k,) index in that list
    values: FloatArray  # (k, width) as the section's module says

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t_ns)


Samples = JointSamples | ImuSamples | AttitudeSamples | DeviceSamples
_S = TypeVar("_S", JointSamples, ImuSamples, AttitudeSamples, DeviceSamples)


def joined(parts: Sequence[_S]) -> _S:
    """Return consecutive batches of one kind as one batch; `parts` must not be empty."""
    if len(parts) == 1:
        return parts[0]
    names = [item.name for item in fields(parts[0]) if item.name != "section"]
    columns: dict[str, Any] = {n: np.concatenate([getattr(p, n) for p in parts]) for n in names}
    return replace(parts[0], **columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelWindow:
    """Every accepted sample of one channel whose validity lies in one window, in time order."""

    t_ns: NDArray[np.int64]  # (k,)
    values: FloatArray  # (k, width)
    missing: bool  # too few samples to evaluate
    stale: bool  # no sample for longer than the channel's freshness limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """All channels over one common interval [start_ns, stop_ns)."""

    index: int
    start_ns: int
    stop_ns: int
    joints: tuple[ChannelWindow, ...]  # values: [position_rad (or speed), torque_nm], NaN: unusable
    gyro: ChannelWindow  # values: w_NS_S_rad_s
    accelerometer: ChannelWindow  # values: f_NS_S_m_s2
    attitude: ChannelWindow  # values: q_NB_xyzw
    devices: Mapping[str, tuple[ChannelWindow, ...]] = field(default_factory=dict)  # by section

    def of(self, section: str) -> tuple[ChannelWindow, ...]:
        """Return the channels of the devices of one section of the configuration."""
        return self.devices.get(section, ())


def _no_rows() -> FloatArray:
    return np.zeros((0, 0))


def _no_times() -> FloatArray:
    return np.zeros(0)


def _no_noise() -> FloatArray:
    return np.zeros((0, 0, 0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
    """One window compressed to m Gauss-Legendre nodes; n joints in the robot model's order.

    The t torques are those of the joints, then the six axes of each wrench sensor [N, N m].

    Every channel is a local polynomial of its samples in the window, evaluated at the same m
    instants. Values of a least-squares polynomial of degree m-1 at m Gauss nodes are uncorrelated
    and together hold all information of the polynomial. Covariances are of the values at all nodes.
    """

    index: int
    t_ns: NDArray[np.int64]  # (m,) node times
    q_rad: FloatArray  # (m, n) joint positions
    qd_rad_s: FloatArray  # (m, n)
    qdd_rad_s2: FloatArray  # (m, n)
    tau_nm: FloatArray  # (m, t)
    w_NB_B_rad_s: FloatArray  # (m, 3) gyro rotated to B, bias not removed
    wd_NB_B_rad_s2: FloatArray  # (m, 3) derivative of w
    f_NS_B_m_s2: FloatArray  # (m, 3) specific force at the sensor, in B axes, bias not removed
    R_NB: FloatArray  # (m, 3, 3) attitude; identity where it is not known
    cov_joint: (
        FloatArray  # (n, 2 m, 2 m) of [qd, qdd] at the nodes, or (n, 3 m, 3 m) of [qd, qdd, q]
    )
    cov_tau: FloatArray  # (t, m, m)
    cov_gyro: FloatArray  # (2 m, 2 m) of one axis: [w at the nodes, wd at the nodes]
    cov_acc: FloatArray  # (m, m) of one axis
    has_joint: NDArray[np.bool_]  # (t,) torque usable
    has_gyro: bool
    has_accelerometer: bool
    has_attitude: bool
    # (L, t) mean products of the torques' residuals at L lags of samples; zero: not known
    tau_products_nm2: FloatArray = field(default_factory=lambda: np.zeros((1, 1)))
    # (L, 2) the same for gyro and accelerometer, mean over the axes
    imu_products: FloatArray = field(default_factory=lambda: np.zeros((1, 2)))
    # k parts of the base that turn about their axes, in configured order; empty without any
    carried_nms: FloatArray = field(default_factory=_no_rows)  # (m, k) momentum
    carried_nm: FloatArray = field(default_factory=_no_rows)  # (m, k) its derivative
    cov_carried: FloatArray = field(default_factory=_no_noise)  # (k, 2 m, 2 m) of both at the nodes
    # K valves; empty without any
    edges: FloatArray = field(default_factory=_no_rows)  # (MOST_EDGES, 3), see effects/switched
    opened_s: FloatArray = field(default_factory=_no_times)  # (K,) open time up to window start
    # (n,) variance of integrated joint angles' error at the window's start; empty: no such joint
    walk_rad2: FloatArray = field(default_factory=_no_times)

    @property
    def stored(self) -> tuple[str, ...]:
        """Names of the fields to store, without those of absent parts."""
        without = {name for part in PARTS if not getattr(self, part[-1]).size for name in part}
        return tuple(item.name for item in fields(self) if item.name not in without)

    @property
    def is_empty(self) -> bool:
        """Whether nothing but the joints' motion was measured."""
        imu = self.has_gyro or self.has_accelerometer or self.has_attitude
        return not imu and not self.has_joint.any()

    @property
    def is_complete(self) -> bool:
        """Whether every torque, the rate and the specific force were measured."""
        return self.has_gyro and self.has_accelerometer and bool(self.has_joint.all())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyEstimate:
    """Inertial parameters of one body in its own frame (base: B; target: tool frame E)."""

    mass_kg: float
    com_m: FloatArray  # (3,)
    inertia_kg_m2: FloatArray  # (6,) xx xy xz yy yz zz about the centre of mass
    mass_sigma_kg: float
    com_sigma_m: FloatArray  # (3,)
    inertia_sigma_kg_m2: FloatArray  # (6,)
    physically_consistent: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate:
    """A published estimate: the mean always comes with its covariance and validity."""

    t_ns: int
    reasons: tuple[str, ...]  # why not valid, the most severe first; empty when valid
    method: str
    names: tuple[str, ...]  # one name per state
    mean: FloatArray  # (p,) estimation coordinates: 10 per unknown body, then nuisances
    covariance: FloatArray  # (p, p)
    bodies: dict[str, BodyEstimate]  # "base" and/or "target"
    blocks: int  # windows used
    gated: int  # windows (or channels of one) rejected by the innovation gate
    nis: float  # normalised innovation squared of the newest block
    nis_dof: int
    condition_number: float  # of the whitened, prior-scaled information
    information_gained_nats: float  # 1/2 log det(prior cov) - 1/2 log det(cov), unknown bodies
    whole: BodyEstimate | None = None  # all bodies together at the current posture, in B
    extra: dict[str, float] = field(default_factory=dict)

    @property
    def valid(self) -> bool:
        """Whether the estimate may be used."""
        return not self.reasons

    @property
    def reason(self) -> str:
        """The most severe reason why the estimate is not valid; empty when valid."""
        return next(iter(self.reasons), "")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Snapshot:
    """The estimator's whole state between two windows, and the grid its windows lie on."""

    t_ns: int
    grid_ns: int | None  # start of window 0; None before the first SYNC
    state: Mapping[str, Any]  # plain values and arrays
    refers: tuple[int, ...] = ()  # indexes of the blocks that the state needs, in order
    blocks: tuple[Block, ...] = ()  # these blocks; empty on the way from the loop to the service
    changes: tuple[Mapping[str, Any], ...] = ()  # unknowns chosen since the start, in order
    identifying: bool = True  # whether windows reach the estimator


@dataclass(frozen=True, slots=True)
class Event:
    """Something an operator should know; severity is info, low, medium or high."""

    t_ns: int
    severity: str
    code: str
    text: str

    def __post_init__(self) -> None:
        """Cut the text to `MAX_EVENT_TEXT` and escape characters that UTF-8 cannot encode."""
        text = self.text[:MAX_EVENT_TEXT].encode(errors="backslashreplace").decode()
        object.__setattr__(self, "text", text[:MAX_EVENT_TEXT])
