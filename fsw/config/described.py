"""Conditions between buses and the devices on them, where some are described."""

from collections.abc import Mapping, Sequence

from fsw.config.actuators import Actuator
from fsw.config.buses import BusConfig
from fsw.config.joints import JointConfig
from fsw.config.signals import BY_SYNC


def descriptions_go_with(
    buses: Sequence[BusConfig],
    joints: Sequence[JointConfig],
    actuators: Mapping[str, Actuator],
) -> None:
    """Raise ValueError for a bus that does not give its devices the SYNC that they need."""
    for i, bus in enumerate(buses):
        if bus.feed is not None:
            continue
        own = [(k, joint) for k, joint in enumerate(joints) if joint.bus == bus.name]
        drivers = {joint.driver for _, joint in own}
        if len(drivers) > 1 and "described" in drivers:
            raise ValueError(f"buses.{i}.name: joints of drivers {sorted(drivers)}; must be of one")
        tailored = [joint.name for _, joint in own if joint.driver == "canopen"]
        others = {at: other for at, other in actuators.items() if other.bus == bus.name}
        tailored += [other.name for other in others.values() if other.driver == "canopen"]
        for key, value, is_bare in (
            ("sync", bus.sync, bus.sync == "none"),
            ("sync_counter_max", bus.sync_counter_max, bus.sync_counter_max == 0),
        ):
            if tailored and is_bare:
                raise ValueError(f"buses.{i}.{key}: {value!r}; {tailored[0]!r} needs its counter")
        timed = {f"joints.{k}": joint.timing for k, joint in own}
        timed |= {at: other.timing for at, other in others.items()}
        for k, joint in own:
            if bus.listen_only and joint.pdo != "trusted":
                raise ValueError(
                    f"joints.{k}.pdo: {joint.pdo!r}; buses.{i}.listen_only sends nothing"
                )
        for at, timing in timed.items():
            by = "" if timing is None else timing.by
            if by in BY_SYNC and bus.sync == "none":
                raise ValueError(f"{at}.timing.by: {by!r}; buses.{i}.sync is none")
            if by == "echoed_counter" and bus.sync_counter_max == 0:
                raise ValueError(f"{at}.timing.by: {by!r}; buses.{i}.sync_counter_max is 0")
