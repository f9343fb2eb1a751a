"""The CAN interfaces that a configuration may name, without python-can, which would open devices.

`tests/unit/fsw/checks/test_configuration.py` compares them with python-can's own.
"""

from difflib import get_close_matches
from importlib.metadata import entry_points

from fsw.config import BusConfig
from fsw.config.feed import SAMPLES

SIMULATED = ("udp_multicast", "udp_frames", "virtual")  # have no physical bit rate
PHYSICAL = (
    *("canalystii", "cantact", "etas", "gs_usb", "iscan", "ixxat", "kvaser", "neousys", "neovi"),
    *("nican", "nixnet", "pcan", "robotell", "seeedstudio", "serial", "slcan", "socketcan"),
    *("socketcand", "systec", "usb2can", "vector"),
)


def interface_fault(bus: BusConfig) -> str:
    """Return the fault of an interface that nothing offers; empty: it is known or not given."""
    plugins = {entry.name for entry in entry_points(group="can.interface")}
    known = sorted({*SIMULATED, *PHYSICAL, *plugins, SAMPLES})
    if bus.interface is None or bus.interface in known:
        return ""
    close = get_close_matches(bus.interface, known, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{bus.interface!r} is not known; {hint}known are {', '.join(known)}"
