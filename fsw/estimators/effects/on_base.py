"""Parts that the base carries: what the checks say of the entries of one section."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from fsw.config import Config, Section
from fsw.messages import FloatArray

Costly = tuple[tuple[Section, ...], str]  # the entries that stay, and what the others do, in words


def _nothing(*_: object) -> tuple[()]:
    return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class OnBase:
    """One kind of part.

    Attributes
    ----------
    section : the list in the configuration
    absent : what a robot without such parts lacks, in words
    is_possible : whether a robot can have such parts at all
    words : a line for each part, and lines on what the model contains
    faults : lines on parts that a base of these parameters (10,) cannot contain
    warnings : lines on parts that are unlikely, or that the model does not follow
    left_out : the parts that a model can leave out, while they work along a motion with
        so many seconds of firings
    unplanned : what a planned motion leaves out, in words; the argument: whether anything fires
    """

    section: str
    absent: str
    is_possible: Callable[[Config], bool]
    words: Callable[[Config], list[str]]
    faults: Callable[[Config, FloatArray], Iterable[str]] = _nothing
    warnings: Callable[[Config], Iterable[str]] = _nothing
    left_out: Callable[[Config, float], Sequence[Costly]]
    unplanned: Callable[[bool], str] = lambda _fires: ""


def is_free(config: Config) -> bool:
    """Return whether nothing holds the base."""
    return config.base.motion == "free"
