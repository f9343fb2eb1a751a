"""Work cut into bounded units: a generator that yields after each and returns the result.

The caller decides how many units run in a tick; the result does not depend on that.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

T = TypeVar("T")


def complete(stages: Generator[None, None, T]) -> T:
    """Run all that is left and return the result."""
    while True:
        try:
            next(stages)
        except StopIteration as end:
            result: T = end.value
            return result
