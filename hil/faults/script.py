"""Faults by name, from a scenario's section `faults`, installed on a virtual bench's links.

`install(..., reference=True)` installs the reference of each fault: it only removes the samples
that the fault loses, or marks values invalid that a faulty sensor cannot measure. A run with a
fault is compared with a run with the reference.
"""

from collections.abc import Mapping, Sequence

from hil.faults import can_bus as faults_can
from hil.faults import serial_line as faults_serial
from hil.faults.place import Place, Type
from hil.links.virtual import VirtualBench
from hil.world.scenario import FaultEntry, ScenarioError

TYPES: Mapping[str, Type] = {**faults_can.TYPES, **faults_serial.TYPES}


def install(
    entries: Sequence[FaultEntry],
    world: VirtualBench,
    seed: int,
    start_ns: int,
    *,
    reference: bool = False,
) -> list[Place]:
    """Install faults on a bench that was powered on at `start_ns`; return their places.

    Call this at any time before the first fault begins.

    Raises
    ------
    ScenarioError for an unknown type.
    """
    places = []
    for index, entry in enumerate(entries):
        put = TYPES.get(entry.type)
        if put is None:
            raise ScenarioError(f"faults: type {entry.type!r} is not one of {sorted(TYPES)}")
        place = Place(entry, world, 1000 * seed + index, reference, start_ns)
        put(place)
        places.append(place)
    return places
