"""A collected replay as a report: the sections in their order."""

from __future__ import annotations

from collections.abc import Callable

from fsw.commands.report import channel_sections as channels
from fsw.commands.report import estimate_sections as estimates
from fsw.commands.report.collect import Collected
from fsw.commands.report.view import Section, View

SECTIONS: tuple[Callable[[Collected], Section], ...] = (
    estimates.result,
    estimates.estimates,
    channels.residuals,
    channels.health,
    estimates.excitation,
    estimates.limits,
    channels.timing,
    channels.configuration,
)


def view(collected: Collected) -> View:
    """Return the report of a collected replay."""
    result = collected.result
    estimate = result.estimate
    valid = estimate is not None and estimate.valid
    reason = "no window could be used" if estimate is None else estimate.reason
    unknown = " and ".join(result.unknown)
    return View(
        title=f"{collected.recording.name}: {unknown} by {result.method}",
        verdict="VALID" if valid else f"NOT VALID: {reason}",
        valid=valid,
        sections=[make(collected) for make in SECTIONS],
    )
