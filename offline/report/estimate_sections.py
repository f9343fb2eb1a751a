"""Sections of a report on the identified bodies, their estimates over time and their accuracy."""

from collections.abc import Iterator

import numpy as np

from fsw.exchange.status import body_sigma, body_values
from fsw.messages import BodyEstimate, FloatArray
from offline.replay_result import ReplayResult
from offline.report.collect import Collected
from offline.report.view import TIME, Chart, Section, Table, line_of, thinned_axis, times_s

AXES = ("xx", "xy", "xz", "yy", "yz", "zz")
QUANTITIES = (
    ("mass_kg", "mass", "kg", ("mass",)),
    ("com_m", "centre of mass", "m", ("x", "y", "z")),
    ("inertia_kg_m2", "inertia", "kg m²", AXES),
)
SETTLED = 1 / 3  # share of a run; the range that a chart shows first fits the time after it


def result(c: Collected) -> Section:
    """Return the section with the estimate, its sigma and the verdict in words."""
    rows, result = [], c.result
    for name, body in (result.estimate.bodies if result.estimate else {}).items():
        values, sigmas = body_values(body), body_sigma(body)
        for key, words, unit, parts in QUANTITIES:
            flat, sigma = np.atleast_1d(values[key]), np.atleast_1d(sigmas[key])
            for part, value, one in zip(parts, flat, sigma, strict=True):
                rows.append((name, _named(words, part), f"{value:.6g}", f"{one:.2g}", unit))
    verdicts = (result.diagnosis or {}).get("verdict", {})
    text = [
        *verdicts.values(),
        *_meaning(result),
        "Inertia is about the centre of mass, in the axes of the body.",
    ]
    cut_off = [result.cut_off()] if result.truncated and c.daemon is not None else []
    text += [f"{line}." for line in result.warnings() if line not in cut_off]
    head = ("body", "quantity", "estimate", "1 sigma", "unit")
    return Section(title="Result", text=text, tables=[Table(head=head, rows=rows)])


def _meaning(result: ReplayResult) -> list[str]:
    """Return a sentence on what valid means here, and one on what is known least."""
    estimate = result.estimate
    if estimate is None:
        return []
    if not estimate.valid:
        return ["Not valid means: use none of these values before the reason above is removed."]
    least = max(own for name, body in estimate.bodies.items() for own in _shares(name, body))
    return [
        "Valid means: the data say more than the prior in every direction, and the residuals are "
        f"what the noise explains. Known least is {least[1]}."
    ]


def _shares(name: str, body: BodyEstimate) -> Iterator[tuple[float, str]]:
    """Yield each quantity's sigma over the body's own scale, and words on both."""
    sigmas = body_sigma(body)
    moment = float(np.mean(body.inertia_kg_m2[[0, 3, 5]]))
    scales = {
        "mass_kg": (body.mass_kg, "the mass"),
        "com_m": (float(np.sqrt(abs(moment) / body.mass_kg)), "the radius of gyration"),
        "inertia_kg_m2": (abs(moment), "the mean moment of inertia"),
    }
    for key, words, unit, parts in QUANTITIES:
        scale, what = scales[key]
        for part, sigma in zip(parts, np.atleast_1d(sigmas[key]), strict=True):
            share = float(sigma) / max(scale, 1e-12)
            size = f"1 sigma {sigma:.2g} {unit}, {100 * share:.2g} % of {what}"
            yield share, f"{name} {_named(words, part)}: {size}"


def estimates(c: Collected) -> Section:
    """Return the section with each estimated quantity over time and its band of 3 sigma."""
    charts = []
    t_s = times_s([estimate.t_ns for estimate in c.estimates], c.result.start_ns)
    for name in c.estimates[-1].bodies if c.estimates else ():
        with_body = [
            (t, e.bodies[name]) for t, e in zip(t_s, c.estimates, strict=True) if name in e.bodies
        ]
        x, bodies = [t for t, _ in with_body], [body for _, body in with_body]
        means = [body_values(body) for body in bodies]
        sigmas = [body_sigma(body) for body in bodies]
        scale = []
        for key, words, unit, parts in QUANTITIES:
            mean = np.array([np.atleast_1d(values[key]) for values in means])
            sigma = np.array([np.atleast_1d(values[key]) for values in sigmas])
            charts += [
                _banded(f"{name}: {_named(words, part)}", unit, x, mean[:, k], sigma[:, k])
                for k, part in enumerate(parts)
            ]
            scale.append(line_of(f"{words} [{unit}]", np.linalg.norm(sigma, axis=1)))
        charts.append(
            Chart(
                title=f"{name}: 1 sigma",
                x_label=TIME,
                y_label="1 sigma [own unit]",
                x=thinned_axis(np.array(x)),
                lines=scale,
                log=True,
            )
        )
    note = "The range shown first is that of the last two thirds; double-click shows all."
    return Section(title="Estimate over time", text=[note], charts=charts, in_rows_of=3)


def _named(words: str, part: str) -> str:
    return words if part == words else f"{words} {part}"


def _banded(title: str, unit: str, x: list[float], mean: FloatArray, sigma: FloatArray) -> Chart:
    low, high = mean - 3 * sigma, mean + 3 * sigma
    late = slice(int(len(x) * SETTLED), None)
    span = (float(np.min(low[late])), float(np.max(high[late])))
    return Chart(
        title=f"{title}, with 3 sigma",
        x_label=TIME,
        y_label=f"estimate [{unit}]",
        x=thinned_axis(np.array(x)),
        lines=[line_of("estimate", mean, low, high)],
        y_range=span if np.all(np.isfinite(span)) else None,
    )


def excitation(c: Collected) -> Section:
    """Return the section with the motion of the joints and the information gained from it."""
    charts = []
    if c.blocks:
        t_s = np.array(times_s([int(block.t_ns[0]) for block in c.blocks], c.result.start_ns))
        sliding = any(joint.kind == "prismatic" for joint in c.config.joints)
        for words, unit, values in (
            (
                "position",
                "rad, m" if sliding else "rad",
                np.array([block.q_rad[0] for block in c.blocks]),
            ),
            (
                "speed",
                "rad/s, m/s" if sliding else "rad/s",
                np.array([block.qd_rad_s[0] for block in c.blocks]),
            ),
        ):
            lines = [line_of(joint.name, values[:, k]) for k, joint in enumerate(c.config.joints)]
            charts.append(
                Chart(
                    title=f"Joint {words}",
                    x_label=TIME,
                    y_label=f"{words} [{unit}]",
                    x=thinned_axis(t_s),
                    lines=lines,
                )
            )
    if len(c.estimates) > 1:
        x = thinned_axis(np.array(times_s([e.t_ns for e in c.estimates], c.result.start_ns)))
        gained = np.array([e.information_gained_nats for e in c.estimates])
        condition = np.array([e.condition_number for e in c.estimates])
        charts += [
            Chart(
                title="Information about the bodies",
                x_label=TIME,
                y_label="gained [nat]",
                x=x,
                lines=[line_of("gained over the prior", gained)],
            ),
            Chart(
                title="Condition of the scaled information",
                x_label=TIME,
                y_label="condition number [1]",
                x=x,
                log=True,
                lines=[line_of("condition number", condition)],
            ),
        ]
    return Section(title="Excitation", charts=charts, in_rows_of=2)


def limits(c: Collected) -> Section:
    """Return the section on the limits of the accuracy.

    Its three tables are the shares of sigma squared by cause, the combinations of states that the
    data determine worst, and the strongest correlations.
    """
    tables, text = [], []
    if c.shares:
        causes = sorted({cause for shares in c.shares.values() for cause in shares})
        rows = [
            (name, *(f"{100 * shares[cause]:.1f} %" for cause in causes))
            for name, shares in c.shares.items()
        ]
        tables.append(Table(head=("quantity", *causes), rows=rows))
        text.append(
            "By how much sigma squared would fall if a cause were known exactly; of a vector, its "
            "worst component. Correlated causes share their part, so a row may add up to more "
            "than 100 %; noise is the rest."
        )
    diagnosis = c.result.diagnosis or {}
    weakest = diagnosis.get("combinations", [])[:5]
    if weakest:
        rows = [(f"{one['gain']:.3g}", one["known_by"], one["combination"]) for one in weakest]
        head = ("data over prior", "known by", "weakest combinations, in prior sigmas")
        tables.append(Table(head=head, rows=rows))
    strongest = diagnosis.get("strongest_correlations", [])
    if strongest:
        rows = [(" and ".join(one["between"]), f"{one['correlation']:.3f}") for one in strongest]
        tables.append(Table(head=("strongest correlations between", "correlation"), rows=rows))
    return Section(title="Limits of the accuracy", text=text, tables=tables)
