"""Parts that the base carries: what the checks say about the entries of one section."""

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
    section : name of the list in the configuration
    absent : what a robot without such parts lacks, in words
    is_possible : returns whether a robot can have such parts at all
    words : returns a line for each part, and lines about what the model contains
    faults : returns a line for each part that a base with these parameters (10,) cannot contain
    warnings : returns lines about parts that are unlikely, or that the model does not follow
    left_out : returns the parts that a model can leave out; the argument is the time of firing
        along the motion [s]
    unplanned : returns in words what a planned motion leaves out; the argument: whether
        anything fires
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
