"""Build the view of a report from a collected replay: its sections, in order."""

from fsw.commands.report import channel_sections as channels
from fsw.commands.report import estimate_sections as estimates
from fsw.commands.report.collect import Collected
from fsw.commands.report.live import now
from fsw.commands.report.view import Section, View


def sections_of(collected: Collected) -> list[Section]:
    """Return the sections that every report has, from health to configuration."""
    return [
        channels.health(collected),
        estimates.limits(collected),
        estimates.excitation(collected),
        channels.residuals(collected),
        channels.configuration(collected),
    ]


def view(collected: Collected) -> View:
    """Return the view of the report of a collected replay."""
    result, status = collected.result, collected.daemon
    sections = [
        estimates.result(collected),
        estimates.estimates(collected),
        *sections_of(collected),
    ]
    sections.insert(-1, channels.timing(collected))
    unknown = " and ".join(result.unknown)
    if status is None:
        estimate = result.estimate
        valid = estimate is not None and estimate.valid
        reason = "no window could be used" if estimate is None else estimate.reason
        title, until = collected.name, ""
    else:
        newest = status.get("estimate") or {"valid": False, "reason": "no window yet"}
        valid, reason = bool(newest["valid"]), str(newest["reason"])
        elapsed_s = (int(status["t_ns"]) - result.start_ns) * 1e-9
        title, until = f"{collected.config.name}, live", f" after {elapsed_s:.0f} s"
        sections.insert(0, now(status, closed=not result.truncated))
    return View(
        title=f"{title}: {unknown} by {result.method}",
        verdict=("VALID" if valid else f"NOT VALID: {reason}") + until,
        valid=valid,
        sections=sections,
    )
