"""Whether sections go with one another: each fault is a ValueError with key, value and bound."""

from collections.abc import Mapping, Sequence

from fsw.config.buses import BusConfig
from fsw.config.joints import JointConfig
from fsw.config.processing import EstimatorConfig
from fsw.config.robot import METHODS_HELD, BaseConfig, BodyConfig
from fsw.config.sensors import ImuConfig
from fsw.errors import ConfigError

NAMED_BY_PLACE = ("base", "target")
FRAMES = "base is the root link, target in robot.tool_frame, any other body in a frame of its own"
MOST_DELAY = 0.1  # of a window, beyond which its polynomial is not extended
HEARTBEATS_MISSED = 1.5  # nodes that toggle after fewer heartbeats would leave a healthy bus
SYNCS_UNANSWERED = 5  # fewer unanswered SYNCs may be chance


def bodies_have_their_keys(bodies: Mapping[str, BodyConfig], unknown: Sequence[str]) -> None:
    """Raise ValueError for a body with a missing or needless frame, or an unknown without prior."""
    for name, body in bodies.items():
        if (body.frame is None) != (name in NAMED_BY_PLACE):
            must = "must be left out" if name in NAMED_BY_PLACE else "missing"
            raise ValueError(f"bodies.{name}.frame: {must}; {FRAMES}")
    for name in unknown:
        if name not in bodies:
            raise ValueError(f"bodies.{name}: missing; unknown lists {name!r}, which needs a prior")
        if bodies[name].sigma is None:
            raise ValueError(f"bodies.{name}.sigma: missing; unknown lists {name!r}")


def base_goes_with(
    base: BaseConfig, unknown: Sequence[str], estimator: EstimatorConfig, *, orbit: bool
) -> None:
    """Raise ValueError for settings that do not suit a planar or clamped base."""
    if base.motion == "free":
        return
    if base.motion == "clamped" and "base" in unknown:
        raise ValueError("unknown: 'base' cannot be found while base.motion is clamped")
    methods = METHODS_HELD[base.motion]
    if estimator.method not in methods:
        raise ValueError(
            f"estimator.method: {estimator.method!r} needs a free base, base.motion is "
            f"{base.motion}; must be {' or '.join(methods)}"
        )
    if orbit:
        raise ValueError(f"orbit: base.motion is {base.motion}; leave it out")
    if base.motion == "clamped" and estimator.momentum_sigma_nms:
        raise ValueError(
            f"estimator.momentum_sigma_nms: {estimator.momentum_sigma_nms:g}; a clamped base has "
            "no momentum; must be 0"
        )


def method_has_its_torques(method: str, joints: Sequence[JointConfig]) -> None:
    """Raise ValueError if the method needs all torques and a joint has no torque sensor."""
    blind = [joint.name for joint in joints if joint.torque == "none"]
    if blind and method == "mrnea":
        raise ValueError(
            f"estimator.method: 'mrnea' needs the torque of every joint; {blind[0]!r} has "
            "torque: none; must be fused, rda or cm"
        )


def delays_fit(
    joints: Sequence[JointConfig], buses: Sequence[BusConfig], imu: ImuConfig, window_s: float
) -> None:
    """Raise ValueError for a delay in the model that is too long, or that nothing can show.

    The limit is a tenth of a window. Delays of buses and of the inertial unit need joints and unit.
    """
    for key, value in delays_of(joints, buses, imu).items():
        if abs(value) > window_s * MOST_DELAY:
            raise ValueError(
                f"{key}: {value:g} must be at most {MOST_DELAY:g} estimator.window_s, "
                f"{window_s * MOST_DELAY:g}"
            )
        if value and not (key.startswith("joints.") or (imu.present and joints)):
            raise ValueError(f"{key}: {value:g} without joints and imu; must be 0")


def delays_of(
    joints: Sequence[JointConfig], buses: Sequence[BusConfig], imu: ImuConfig
) -> dict[str, float]:
    """Return every delay of the model by its key [s], and 1 sigma of those that are states."""
    found = {"imu.delay_sigma_s": imu.delay_sigma_s}
    found |= {f"buses.{i}.delay_sigma_s": bus.delay_sigma_s for i, bus in enumerate(buses)}
    for i, joint in enumerate(joints):
        own = {key: getattr(joint, key) for key in ("torque_delay_s", "torque_delay_sigma_s")}
        found |= {f"joints.{i}.{key}": value for key, value in joint.named(own).items()}
    return found


def method_takes_delays(method: str, delays: Mapping[str, float]) -> None:
    """Raise ConfigError for a delay in the model of a method that predicts no torque."""
    for key, value in delays.items():
        if value and method == "ce":
            raise ConfigError(f"{key}: {value:g}; method 'ce' predicts no torque: must be 0")


def redundancy_works(i: int, bus: BusConfig) -> None:
    """Raise ValueError for a redundant pair on which master and nodes may use different buses."""
    pair = bus.redundant
    if pair is None:
        return
    if bus.sync != "producer":
        raise ValueError(f"buses.{i}.redundant: needs sync: producer; the master selects the bus")
    if bus.heartbeat_s is None:
        raise ValueError(f"buses.{i}.redundant: needs heartbeat_s; the nodes follow the heartbeat")
    if bus.heartbeat_s * HEARTBEATS_MISSED > pair.nodes_toggle_s:
        raise ValueError(
            f"buses.{i}.redundant.nodes_toggle_s: {pair.nodes_toggle_s} must be at least "
            f"{HEARTBEATS_MISSED:g} heartbeat_s, {bus.heartbeat_s * HEARTBEATS_MISSED:g}"
        )
    if pair.lost_after_s * bus.rate_hz < SYNCS_UNANSWERED:
        raise ValueError(
            f"buses.{i}.redundant.lost_after_s: {pair.lost_after_s} must be at least "
            f"{SYNCS_UNANSWERED} SYNC periods, {SYNCS_UNANSWERED / bus.rate_hz:g}"
        )


def require_unique(values: list[str], key: str) -> None:
    """Raise ValueError for a value that is used twice."""
    for value in values:
        if values.count(value) > 1:
            times = values.count(value)
            raise ValueError(f"{key}: {value!r} is used {times} times; must be unique")


def require_one_device_each(ports: dict[str, str]) -> None:
    """Raise ValueError for two keys that name one port."""
    for port in ports.values():
        keys = [other for other, used in ports.items() if used == port]
        if len(keys) > 1:
            raise ValueError(
                f"{' and '.join(keys)}: all name {port!r}; a port serves one device only"
            )
