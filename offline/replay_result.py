"""Result of a replay: plain values for scripts, a short table for people."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fsw.estimators import parameter_verdicts
from fsw.estimators.noise.few_windows import too_few
from fsw.exchange.status import estimate_summary
from fsw.messages import Estimate, Event
from offline.unused import unused_lines

SHOWN_EVENTS = 20


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ReplayResult:
    """Result of a replay; `estimate` is None if no window could be used."""

    estimate: Estimate | None
    unknown: tuple[str, ...]
    method: str
    status: Mapping[str, Any]
    truncated: bool
    dropped: int  # messages that the recorder did not write
    missed: Sequence[str] = ()  # a line for each needed sensor of which nothing can be used
    wall_s: float
    diagnosis: Mapping[str, Any] | None = None  # None: no estimate to judge
    events: Sequence[Event] = ()
    start_ns: int = 0  # first message of the replayed part
    duration_s: float = 0.0  # of the replayed part
    least_windows: int = 0  # that a valid estimate needs

    def cut_off(self) -> str:
        """Return the warning for a recording that is `truncated`."""
        return f"the recording is cut off at its end; {self.duration_s:.1f} s of it were read"

    def warnings(self) -> list[str]:
        """Return a line for a cut-off recording, and for each sensor of which nothing is used."""
        unused = [line for line in unused_lines(self.status) if not self._is_missed(line)]
        return [*([self.cut_off()] if self.truncated else []), *self.missed, *unused]

    def _is_missed(self, line: str) -> bool:
        return any(missed.startswith(line) for missed in self.missed)

    def to_json(self) -> dict[str, Any]:
        """Return plain values under the keys that all commands use."""
        summary = estimate_summary(self.estimate) or {
            "valid": False,
            "reason": "NO_DATA",
            "reasons": ["NO_DATA"],
        }
        return {
            "unknown": list(self.unknown),
            "method": self.method,
            "estimate": {},
            "sigma": {},
            "whole": None,
            **summary,
            **_state(self.estimate),
            "diagnosis": self.diagnosis,
            "samples": self.status["samples"],
            "windows": self.status["windows"],
            "health": self.status["health"],
            "events": [
                {
                    "t_s": (event.t_ns - self.start_ns) * 1e-9,
                    "severity": event.severity,
                    "code": event.code,
                    "text": event.text,
                }
                for event in self.events
            ],
            "warnings": self.warnings(),
            "truncated": self.truncated,
            "dropped": self.dropped,
            "wall_s": self.wall_s,
        }

    def __repr__(self) -> str:
        return self.to_text()

    def to_text(self) -> str:
        """Return a short table: parameters with their sigma, then the sources."""
        values = self.to_json()
        state = in_words(values["reasons"])
        lines = [f"{self.method}, unknown {', '.join(self.unknown)}: {state}"]
        if "TOO_FEW_BLOCKS" in values["reasons"] and self.estimate is not None:
            lines.append(too_few(self.estimate.blocks, self.least_windows))
        for body, estimate in values["estimate"].items():
            for key, mean in estimate.items():
                sigma = values["sigma"][body][key]
                lines.append(f"{body}.{key}: {with_sigma(mean, sigma)}")
            lines += known_by(self.diagnosis, body)
        if self.diagnosis is not None:
            lines += list(self.diagnosis["verdict"].values())
        for source, counts in values["samples"].items():
            words = [f"{word} {counts[word]}" for word in ("received", "lost", "late", "rejected")]
            lines.append(f"{source}: {', '.join(words)}")
        if self.estimate is not None:
            nis, dof = self.estimate.nis, self.estimate.nis_dof
            lines.append(
                f"last window's residuals: {nis:.0f} for {dof}, {self.estimate.gated} gated"
            )
        shown = [event for event in values["events"] if event["severity"] != "info"]
        shown = shown[:SHOWN_EVENTS]
        lines += [
            f"{event['t_s']:.2f} s {event['severity']} {event['code']}: {event['text']}"
            for event in shown
        ]
        lines.append(f"{len(self.events)} events, {len(shown)} shown; the field events has all")
        lines.append(f"wall {self.wall_s:.2f} s")
        return "\n".join(lines)


def _state(estimate: Estimate | None) -> dict[str, Any]:
    """Return names, mean and covariance of the published states; all empty without an estimate."""
    if estimate is None:
        return {"names": [], "mean": [], "covariance": []}
    return {
        "names": list(estimate.names),
        "mean": estimate.mean.tolist(),
        "covariance": estimate.covariance.tolist(),
    }


def known_by(diagnosis: Mapping[str, Any] | None, body: str) -> list[str]:
    """Return a line on whether data, prior or nothing determines each parameter of a body."""
    words = {} if diagnosis is None else diagnosis.get("parameters", {})
    return [f"{body}: {parameter_verdicts.in_words(words[body])}"] if body in words else []


def in_words(reasons: Sequence[str]) -> str:
    """Return whether an estimate is valid, with every reason why it is not."""
    return f"not valid: {', '.join(reasons)}" if reasons else "valid"


def with_sigma(mean: float | Sequence[float], sigma: float | Sequence[float]) -> str:
    """Return values with their sigma, as every command prints them."""
    pairs = zip(np.atleast_1d(mean), np.atleast_1d(sigma), strict=True)
    return ", ".join(f"{value:.6g} +- {one:.2g}" for value, one in pairs)
