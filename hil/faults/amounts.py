"""By how much a fault of a script changes what a sensor measures, at its place."""

from collections.abc import Callable

from hil.faults import values
from hil.faults.place import Place


def drift(rate: float) -> Callable[[Place], values.Change]:
    """Return a drift of so much per second since the fault began."""
    return lambda place: values.drifting(place.size(rate), place.window_ns[0])


def shift(offset: float) -> Callable[[Place], values.Change]:
    """Return a shift by an offset."""
    return lambda place: values.shifted(place.size(offset))


def scale(ratio: float) -> Callable[[Place], values.Change]:
    """Return a wrong scale."""
    return lambda place: values.scaled(place.size(ratio))


def stuck(_place: Place) -> values.Change:
    """Return the first value seen, for ever."""
    return values.Stuck()
