"""A group of states: one record with everything that the other rooms must know of it.

A group has one state for each of its labels, with a zero-mean Gaussian prior. If all sigmas are
zero, the group is not part of the state.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fsw.config import Config, JointConfig
from fsw.estimators.model.walks import Walks

Spread = tuple[Sequence[str], Sequence[float]]  # labels of a group's states, and their sigmas


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """What the priors depend on; joints are in the model's order."""

    config: Config
    joints: Sequence[JointConfig]
    walks: Walks | None


def _always(_config: Config) -> bool:
    return True


def _nothing(_setting: Setting) -> Spread:
    return (), ()


@dataclass(frozen=True, slots=True, kw_only=True)
class StateGroup:
    """One kind of state; "states" below are those of the group.

    Attributes
    ----------
    name : first part of the states' names, such as `torque_offset` of `torque_offset.joint1`
    effect : what the states are, in words
    key : configuration key of the prior
    cause : name under which the report counts the states' share of the variance; empty: `effect`
    prior : returns labels and sigmas for a configuration; groups that others append have none
    is_possible : returns whether a robot with the key's section can have the effect
    is_calibration : whether the states are errors of arm or sensors; without them, these are exact
    is_hidden : whether published estimates leave the states out, as they do calibration
    is_judged : whether a value far from its prior makes the estimate implausible
    is_repeated : whether two runs of one robot have the states in common
    drift : share of its own size by which a state differs between two runs of one robot
    is_steady : whether the states are constant in time, unlike a bias, which creeps
    is_free : whether the prior may be widened as far as the data require
    shared : share of the variance that is common to all states of the group
    mistake : the key whose value is wrong where the data contradict the prior; empty: none
    axes : labels of the three states of a vector
    doubt : of a mounting: 1 sigma with which a check looks for a wrong one if `key` states none
    unknown : of a mounting: 1 sigma if nothing is known
    calibrated_from : least prior sigma with which `fsw calibrate` estimates; 0: that of `key`
    amount : returns the size of the effect in words; None: the largest prior sigma
    """

    name: str
    effect: str
    unit: str
    key: str
    cause: str = ""
    prior: Callable[[Setting], Spread] = _nothing
    is_possible: Callable[[Config], bool] = _always
    is_calibration: bool = False
    is_hidden: bool = False
    is_judged: bool = False
    is_repeated: bool = False
    drift: float = 0.0
    is_steady: bool = False
    is_free: bool = False
    shared: float = 0.0
    mistake: str = ""
    axes: Sequence[str] = "xyz"
    doubt: float = 0.0
    unknown: float = 0.0
    calibrated_from: float = 0.0
    amount: Callable[[Config], str] | None = None

    @property
    def title(self) -> str:
        """Return effect and unit."""
        return f"{self.effect} [{self.unit}]" if self.unit else self.effect

    @property
    def is_published(self) -> bool:
        """Return whether an estimate contains the states."""
        return not (self.is_calibration or self.is_hidden)

    @property
    def section(self) -> str:
        """Return the section of the key."""
        return self.key.partition(".")[0].removesuffix("[]")

    @property
    def field(self) -> str:
        """Return the configuration key without its section, such as `gyro_bias_sigma_rad_s`."""
        return self.key.partition(".")[2]

    @property
    def joint_key(self) -> str:
        """Return the key within a joint's section; empty: the key is of another section."""
        return self.field if self.section == "joints" else ""

    @property
    def is_constant_of_sensor(self) -> bool:
        """Return whether the states are constants of joints or inertial unit that may creep."""
        own = self.section in ("joints", "imu") and not self.is_steady
        return own and "_sigma_" in self.field

    @property
    def is_exact_if_absent(self) -> bool:
        """Return whether a model without the states treats a constant as exact, not as absent."""
        return self.is_judged or not self.is_published

    def applies_to(self, config: Config) -> bool:
        """Return whether a robot has the devices and effects that the states describe."""
        own = getattr(config, self.section)
        has = config.imu.present if self.section == "imu" else bool(own)
        return has and self.is_possible(config)


def is_of_current(config: Config) -> bool:
    """Return whether the torque of a joint is that of its motor's current."""
    return any(joint.torque == "motor_current" for joint in config.joints)


def per_joint(key: str) -> Callable[[Setting], Spread]:
    """Return the prior of one state for each joint, whose sigma is a key of the joint."""

    def prior(setting: Setting) -> Spread:
        joints = setting.joints
        return [joint.name for joint in joints], [getattr(joint, key) for joint in joints]

    return prior


def per_part(section: str, key: str) -> Callable[[Setting], Spread]:
    """Return the prior of one state for each entry of a list of sections."""

    def prior(setting: Setting) -> Spread:
        parts = getattr(setting.config, section)
        return [part.name for part in parts], [getattr(part, key) for part in parts]

    return prior
