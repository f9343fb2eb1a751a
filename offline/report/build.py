"""Build the view of a report from a collected replay: its sections, in order."""

from offline.report import channel_sections as channels
from offline.report import estimate_sections as estimates
from offline.report.collect import Collected
from offline.report.live import now
from offline.report.view import Section, View


def sections_of(collected: Collected) -> list[Section]:
    """Return the sections that every report has, from health to configuration."""
    return [
        channels.health(collected),
        estimates.limits(collected),
        estimates.excitation(collected),
        channels.residuals(collected),
        channels.configuration(collected),
    ]


def valid_words(collected: Collected) -> str:
    """Return the headline of a valid estimate; it names channels with too large residuals."""
    wide = () if collected.residuals is None else collected.residuals.wide()
    return f"VALID, with residuals wider than declared: {', '.join(wide)}" if wide else "VALID"


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
        reasons = ("no window could be used",) if estimate is None else estimate.reasons
        title, until = collected.name, ""
    else:
        newest = status.get("estimate") or {"reasons": ["no window yet"]}
        reasons = tuple(newest["reasons"])
        elapsed_s = (int(status["t_ns"]) - result.start_ns) * 1e-9
        title, until = f"{collected.config.name}, live", f" after {elapsed_s:.0f} s"
        sections.insert(0, now(status, closed=not result.truncated))
    return View(
        title=f"{title}: {unknown}, method {result.method}",
        verdict=(f"NOT VALID: {', '.join(reasons)}" if reasons else valid_words(collected)) + until,
        valid=not reasons,
        sections=sections,
    )
