"""A possible mistake: the text that names key and cure, and a change that undoes the mistake."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from offline.checks.trial import Trial

_HALF_S = (0.02, 0.1, 0.25, 0.5, 0.75, 1.0)
SHIFTS_S = (*(-size for size in _HALF_S[::-1]), 0.0, *_HALF_S)
DECADES = tuple(0.5 * k for k in range(-7, 8))
NEAR_PERIOD = 0.15  # of a period: a shift that close to it is one


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mistake:
    """A possible mistake; `change` returns a trial as it would be without the mistake.

    Attributes
    ----------
    text : names key and cure; `{size}` stands for the size
    change : returns the trial without the mistake; arguments: the trial, and the size if it has one
    sizes : first sizes to try: shifts [s], or decimal logarithms of a factor; empty: it has no size
    periods_s : periods by name; a shift of one period gets a hint at another cause
    """

    text: str
    change: Callable[..., Trial]
    sizes: Sequence[float] = ()
    periods_s: Mapping[str, float] = field(default_factory=dict)

    def words(self, size: float) -> str:
        """Return the text with its size."""
        if not self.sizes:
            return self.text
        if self.sizes is DECADES:
            way = "large" if size > 0.0 else "small"
            return self.text.format(size=f"{10.0 ** abs(size):.3g} times too {way}")
        hints = [
            f"; that is one period of {name}: is timing of its joints off by one?"
            for name, period_s in self.periods_s.items()
            if abs(abs(size) / period_s - 1.0) < NEAR_PERIOD
        ]
        return "".join([self.text.format(size=f"{size:+.4f}"), *hints])
