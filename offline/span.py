"""A part of a recording between two times, counted from its start."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from math import ceil, inf

from fsw.errors import ConfigError
from fsw.exchange.columns import Column
from fsw.exchange.recording import END_NS, Piece


@dataclass(frozen=True, slots=True)
class Span:
    """The messages of a recording in [from_s, to_s), in seconds from its start."""

    from_s: float = 0.0
    to_s: float = inf

    def __post_init__(self) -> None:
        """Raise ConfigError if a limit is not a number, from_s negative, or the span empty."""
        if not all(isinstance(value, int | float) for value in (self.from_s, self.to_s)):
            raise ConfigError(f"from_s, to_s: {self.from_s!r}, {self.to_s!r} must be numbers [s]")
        if not 0.0 <= self.from_s < inf:
            raise ConfigError(f"--from: {self.from_s:g} must be at least 0 seconds")
        if not self.from_s < self.to_s:
            raise ConfigError(f"--to: {self.to_s:g} must be greater than --from {self.from_s:g}")

    def pieces(self, pieces: Iterator[tuple[Piece, int]]) -> Iterator[tuple[Piece, int]]:
        """Yield each piece of a recording that may contain messages of this span, cut to the span.

        Each piece comes with the time [ns] at which the next piece starts.
        """
        bounds: tuple[float, float] | None = None
        for piece, following_ns in pieces:
            if self == WHOLE:
                yield piece, following_ns
                continue
            if bounds is None:
                bounds = piece.start_ns + self.from_s * 1e9, piece.start_ns + self.to_s * 1e9
            if piece.start_ns >= bounds[1]:
                return
            if following_ns > bounds[0]:
                first_ns = max(piece.start_ns, round(bounds[0]))
                read = partial(_within, piece, bounds)
                yield Piece(first_ns, piece.part, piece.offset, read), following_ns

    def words(self) -> str:
        """Return words to append to a message, " between ... s and ..."; empty for the whole."""
        if self == WHOLE:
            return ""
        end = "its end" if self.to_s == inf else f"{self.to_s:g} s"
        return f" between {self.from_s:g} s and {end}"


WHOLE = Span()


def _within(piece: Piece, bounds: tuple[float, float]) -> dict[str, Column]:
    first_ns, stop_ns = (min(END_NS - 1, ceil(min(bound, END_NS))) for bound in bounds)
    kept = {}
    for topic, column in piece.read().items():
        times_ns = column.spans[:, 0]
        spans = column.spans[(times_ns >= first_ns) & (times_ns < stop_ns)]
        if len(spans):
            kept[topic] = column._replace(spans=spans)
    return kept
