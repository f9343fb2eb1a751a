"""Faults by name, as a scenario's `faults:` lists them, put onto the links of a virtual bench.

`install(..., reference=True)` puts in place of each fault what it truly takes away: the samples
that are gone, or the values of them that a sensor at fault cannot have measured. What a run with a
fault is held against is a run with the reference.
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
    """Put faults onto a bench that was powered on at the start; return where they went.

    They may be put on at any time before the first of them begins.

    Raises
    ------
    ScenarioError for a type that does not exist.
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
