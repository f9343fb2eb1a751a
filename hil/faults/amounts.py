"""Changes of a measured value; each function returns a map from a fault's place to a change."""

from collections.abc import Callable

from hil.faults import values
from hil.faults.place import Place


def drift(rate: float) -> Callable[[Place], values.Change]:
    """Return a drift per second since the start of the fault; `rate` is the default."""
    return lambda place: values.drifting(place.size(rate), place.window_ns[0])


def shift(offset: float) -> Callable[[Place], values.Change]:
    """Return a shift by an offset; `offset` is the default."""
    return lambda place: values.shifted(place.size(offset))


def scale(ratio: float) -> Callable[[Place], values.Change]:
    """Return a multiplication by a ratio; `ratio` is the default."""
    return lambda place: values.scaled(place.size(ratio))


def stuck(_place: Place) -> values.Change:
    """Return a change that repeats the first value."""
    return values.Stuck()
