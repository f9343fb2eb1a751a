"""Faults of a real SocketCAN bus: error frames, links down, a cable cut, frames of other senders.

Daemon and devices use the two ends of a virtual cable (vxcan). So the devices can fall silent while
the daemon's link stays up. `hil vcan` has one slow processor, so rates are low and limits wide.
"""

from collections.abc import Callable
from dataclasses import replace

from evidence.fault_matrix.live_rows import Act, Hold, Lane
from evidence.fault_matrix.run import SCENARIO
from hil.devices.canopen import NMT_ID, SYNC_ID
from hil.faults.real_bus import Babble, Echo, ErrorKind, inject, running, send, set_link
from hil.run.flight import on_socketcan
from hil.world.scenario import Scenario, at_rates, load

NEAR, FAR = "vxcan0", "vxcan1"  # the daemon's end and the devices' end of the cable
RATE_HZ, IMU_RATE_HZ = 100.0, 125
HEALTH = {"silent_periods": 20.0, "late_periods": 20, "jitter_s": 1.0, "tracker_late_s": 1.0}
NODE, STRANGER, TPDO1_ID = 0x13, 0x2A, 0x180
NMT_RESET = 0x81
BABBLE_HZ, STRANGER_HZ = 5000.0, 100.0
DAMAGED = 20  # number of error frames in a burst


def scenario() -> Scenario:
    """Return the scenario at the rates of this lane, with the bus on the cable's near end."""
    chosen = on_socketcan(at_rates(load(SCENARIO), RATE_HZ, IMU_RATE_HZ))
    bus = chosen.flight["bus"] | {"channel": NEAR}
    return replace(chosen, flight=chosen.flight | {"bus": bus})


def _bus_off(_hold: Hold) -> None:
    inject(NEAR, ErrorKind.BUS_OFF)
    set_link(FAR, up=False)


def _restarted(_hold: Hold) -> None:
    set_link(FAR, up=True)
    inject(NEAR, ErrorKind.RESTARTED)


def _while_it_lasts(make: Callable[[Hold], Babble | Echo]) -> Act:
    """Return the actions that start a sender at the fault's beginning and stop it at its end."""
    begun: list[Babble | Echo] = []

    def begin(hold: Hold) -> None:
        begun.append(make(hold))
        hold.stack.enter_context(running(begun[-1]))

    def end(_hold: Hold) -> None:
        begun.pop().stop()

    return Act(begin=begin, end=end)


def lane() -> Lane:
    """Return the lane of the faults of a real bus."""
    return Lane(
        health=HEALTH,
        scenario=scenario(),
        device_channel=FAR,
        acts={
            "vcan_bus_off": Act(begin=_bus_off, end=_restarted),
            "vcan_cut": Act(
                begin=lambda _: set_link(FAR, up=False), end=lambda _: set_link(FAR, up=True)
            ),
            "vcan_link_down": Act(
                begin=lambda _: set_link(NEAR, up=False), end=lambda _: set_link(NEAR, up=True)
            ),
            "vcan_errors": Act(begin=lambda _: inject(NEAR, *[ErrorKind.FORM_ERROR] * DAMAGED)),
            "vcan_babble": _while_it_lasts(lambda hold: Babble(FAR, 0x020, BABBLE_HZ, hold.seed)),
            "vcan_stranger": _while_it_lasts(
                lambda hold: Babble(FAR, TPDO1_ID + STRANGER, STRANGER_HZ, hold.seed)
            ),
            "vcan_node_reset": Act(begin=lambda _: send(FAR, NMT_ID, bytes((NMT_RESET, NODE)))),
            "vcan_sync_doubled": _while_it_lasts(
                lambda hold: Echo(FAR, SYNC_ID, 0.5 / RATE_HZ, 0.1, hold.seed)
            ),
            "vcan_duplicate": _while_it_lasts(
                lambda hold: Echo(FAR, TPDO1_ID + NODE, 0.0, 0.1, hold.seed)
            ),
        },
    )
