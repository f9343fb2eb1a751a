"""Conditions between buses and the devices on them, where some are described."""

from collections.abc import Sequence

from fsw.config.buses import BusConfig
from fsw.config.joints import JointConfig
from fsw.config.signals import BY_SYNC
from fsw.config.thrusters import ThrusterConfig
from fsw.config.wheels import WheelConfig


def descriptions_go_with(
    buses: Sequence[BusConfig],
    joints: Sequence[JointConfig],
    others: Sequence[WheelConfig | ThrusterConfig],
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
        tailored += [o.name for o in others if o.bus == bus.name and o.driver == "canopen"]
        foreign = [o for o in others if isinstance(o, WheelConfig) and o.bus == bus.name]
        for key, value, is_bare in (
            ("sync", bus.sync, bus.sync == "none"),
            ("sync_counter_max", bus.sync_counter_max, bus.sync_counter_max == 0),
        ):
            if tailored and is_bare:
                raise ValueError(f"buses.{i}.{key}: {value!r}; {tailored[0]!r} needs its counter")
        timed = {f"joints.{k}": joint.timing for k, joint in own}
        timed |= {f"wheels.{others.index(wheel)}": wheel.timing for wheel in foreign}
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
