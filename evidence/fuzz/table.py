"""Every target by name; the module of a target is imported when the target is made."""

from collections.abc import Callable
from importlib import import_module

from evidence.fuzz.oracle import Target
from fsw.drivers.codecs.entries import IMU, installed

UNITS = tuple(entry.name for entry in installed(IMU))  # a package beside the tree may add some
SLOW = frozenset(
    {
        *UNITS,
        "sagitta",
        "feed",
        "description",
        "config",
        "recording",
        "tc_frame",
        "file_unit",
        "operations",
        "state",
    }
)  # these targets get fewer inputs
TARGETS: dict[str, tuple[str, ...]] = {  # module, function and its arguments
    **{name: ("evidence.fuzz.serial_targets", "unit_target", name) for name in UNITS},
    "canopen": ("evidence.fuzz.frame_targets", "canopen_target"),
    "recorded_frame": ("evidence.fuzz.frame_targets", "recorded_frame_target"),
    "stim300": ("evidence.fuzz.serial_targets", "stim_target"),
    "mip": ("evidence.fuzz.serial_targets", "mip_target"),
    "sagitta": ("evidence.fuzz.serial_targets", "sagitta_target"),
    "feed": ("evidence.fuzz.feed_target", "feed_target"),
    "description": ("evidence.fuzz.description_target", "description_target"),
    "command": ("evidence.fuzz.text_targets", "command_target"),
    "config": ("evidence.fuzz.text_targets", "config_target"),
    "checkpoint": ("evidence.fuzz.file_targets", "checkpoint_target"),
    "recording": ("evidence.fuzz.file_targets", "recording_target"),
    "state": ("evidence.fuzz.state_target", "state_target"),
    "tc_packet": ("evidence.fuzz.telemetry_targets", "packet_target"),
    "tc_frame": ("evidence.fuzz.telemetry_targets", "frame_target"),
    "file_unit": ("evidence.fuzz.delivery_target", "delivery_target"),
    "operations": ("evidence.fuzz.operations", "operations_target"),
}


def quota(inputs: int, only: str = "") -> dict[str, int]:
    """Return the number of inputs of each target: at least a twentieth of all, more if it is fast.

    If `only` names a target, this target gets all inputs.
    """
    if only:
        return {only: inputs}
    least = -(-inputs // 20)
    fast = len(TARGETS) - len(SLOW)
    rest = max(0, inputs - least * len(SLOW))
    return {name: least if name in SLOW else max(least, -(-rest // fast)) for name in TARGETS}


def make(name: str) -> Target:
    """Return a target. Raises KeyError for an unknown name."""
    module, function, *arguments = TARGETS[name]
    factory: Callable[..., Target] = getattr(import_module(module), function)
    return factory(*arguments)
