"""Sections of a report on sensors (residuals, health, timing) and on the configuration used."""

import numpy as np

from fsw.messages import FloatArray
from offline.report.collect import Collected
from offline.report.spectrum import histogram, spectrum
from offline.report.view import (
    TIME,
    Chart,
    Line,
    Section,
    Table,
    line_of,
    numbers,
    thinned_axis,
    times_s,
)

MOST_EVENTS = 500
SEVERITIES = ("info", "low", "medium", "high")


def residuals(c: Collected) -> Section:
    """Return the section with each channel's residual over time, spectrum and histogram."""
    title = "Residuals"
    if c.residuals is None:
        return Section(title=title, text=["There is no state to predict the channels from."])
    r, charts, rows = c.residuals, [], []
    t_s = np.array(times_s(r.t_ns.tolist(), c.result.start_ns))
    for k, (name, plain) in enumerate(zip(r.names, r.units, strict=True)):
        unit = plain.replace("2", "²")
        value, ratio = r.value[:, k], r.value[:, k] / r.sigma[:, k]
        used = np.isfinite(ratio)
        if used.sum() < 2:
            rows.append((name, unit, "0", "-", "-", "-"))
            continue
        band = 3 * r.sigma[:, k]
        line = line_of("residual", value, -band, band)
        charts.append(
            Chart(
                title=f"{name}: residual, with 3 sigma",
                x_label=TIME,
                y_label=f"residual [{unit}]",
                x=thinned_axis(t_s),
                lines=[line],
            )
        )
        charts += _shapes(name, t_s[used], ratio[used])
        rms = float(np.sqrt(np.mean(value[used] ** 2)))
        rows.append(
            (
                name,
                unit,
                str(used.sum()),
                f"{rms:.3g}",
                f"{ratio[used].mean():.2f}",
                f"{np.sqrt(np.mean(ratio[used] ** 2)):.2f}",
            )
        )
    head = ("channel", "unit", "nodes", "rms", "mean / sigma", "rms / sigma")
    text = [
        "Measured minus predicted at the last state, at the nodes of every window. The band has "
        "teeth because the fit of a window is less certain at its first and last node. The "
        "spectrum of white noise of the stated sigma lies about 1 (noise of the joints' own "
        "derivatives lies lower at low frequencies); the histogram follows the normal density."
    ]
    tables = [Table(head=head, rows=rows)]
    text = [*wide_words(c), *text]
    return Section(
        title=title,
        text=text,
        tables=tables,
        charts=charts,
        folded="Curves, spectra and histograms of every channel",
        in_rows_of=3,
    )


def wide_words(c: Collected) -> list[str]:
    """Return a sentence on channels whose residuals are wider than their sigma; none: no sentence.

    Correct channels get it once in ten thousand.
    """
    wide = {} if c.residuals is None else c.residuals.wide()
    if not wide:
        return []
    named = ", ".join(f"{name} {rms:.2g} times" for name, rms in wide.items())
    return [
        f"WIDER THAN THEIR SIGMA: residuals of {named}. The noise is larger than declared, or the "
        "model lacks something there: fsw check CONFIG RECORDING (fsw.check in Python) says which."
    ]


def _shapes(name: str, t_s: FloatArray, ratio: FloatArray) -> list[Chart]:
    frequency_hz, power = spectrum(t_s, ratio)
    return [
        Chart(
            title=f"{name}: spectrum of residual / sigma",
            x_label="frequency [Hz]",
            y_label="power over white [1]",
            x=frequency_hz.tolist(),
            log=True,
            lines=[
                Line(label="found", y=numbers(power)),
                Line(label="white", y=[1.0] * len(power)),
            ],
        ),
        normalised_chart(f"{name}: histogram of residual / sigma", "residual / sigma [1]", ratio),
    ]


def normalised_chart(title: str, x_label: str, ratio: FloatArray) -> Chart:
    """Return a chart with the histogram of normalised values and the normal density."""
    centre, density, normal = histogram(ratio)
    return Chart(
        title=title,
        x_label=x_label,
        y_label="density [1]",
        x=centre.tolist(),
        bars=True,
        lines=[
            Line(label="found", y=numbers(density)),
            Line(label="normal", y=numbers(normal)),
        ],
    )


def health(c: Collected) -> Section:
    """Return the section with the events, and the windows that the estimator used or rejected."""
    events = c.events
    t_s = times_s([event.t_ns for event in events], c.result.start_ns)
    shown = list(zip(t_s, events, strict=True))
    if len(shown) > MOST_EVENTS:
        shown = [pair for pair in shown if pair[1].severity != "info"][:MOST_EVENTS]
    rows = [(f"{t:.2f}", e.severity, e.code, e.text) for t, e in shown]
    charts = []
    if shown:
        level = [float(SEVERITIES.index(e.severity)) for _, e in shown]
        charts.append(
            Chart(
                title="Events by severity",
                x_label=TIME,
                y_label="severity",
                x=[t for t, _ in shown],
                levels=SEVERITIES,
                y_range=(-0.5, 3.5),
                lines=[Line(label="event", y=list(level), points=True)],
            )
        )
    if len(c.estimates) > 1:
        ratio = np.array([e.nis / max(e.nis_dof, 1) for e in c.estimates])
        x = thinned_axis(np.array(times_s([e.t_ns for e in c.estimates], c.result.start_ns)))
        gated = np.array([float(e.gated) for e in c.estimates])
        valid = np.array([float(e.valid) for e in c.estimates])
        charts += [
            Chart(
                title="Normalised innovation squared of each window",
                x_label=TIME,
                y_label="NIS / freedoms [1]",
                x=x,
                lines=[line_of("found", ratio), Line(label="expected", y=[1.0] * len(x))],
            ),
            Chart(
                title="Validity and rejected windows",
                x_label=TIME,
                y_label="valid, count [1]",
                x=x,
                lines=[line_of("valid", valid), line_of("rejected so far", gated)],
            ),
        ]
    source = " of the run" if events is not c.result.events else " in the replay" if c.name else ""
    open_faults = c.result.status["health"].get("faulty") or {}
    text = [
        f"{len(events)} events{source}, "
        f"{len(shown)} shown; open faults at the end: "
        f"{', '.join(map(str, open_faults)) or 'none'}."
    ]
    tables = [Table(head=("time [s]", "severity", "code", "text"), rows=rows)]
    return Section(title="Health and events", text=text, tables=tables, charts=charts, in_rows_of=3)


def timing(c: Collected) -> Section:
    """Return the section with counts of samples and windows, and the timing of the recorded run."""
    words = ("received", "accepted", "lost", "late", "rejected")
    samples = c.result.status["samples"]
    rows = [(name, *(str(n.get(word, "")) for word in words)) for name, n in samples.items()]
    windows = c.result.status["windows"]
    tables = [
        Table(head=("source, in the replay", *words), rows=rows),
        Table(head=("windows", "count"), rows=[(k, str(v)) for k, v in windows.items()]),
    ]
    charts, text = [], []
    if c.flown:
        last = c.flown[-1]
        text.append(
            f"In the run that was recorded: {last['ticks']} ticks, {last['slips']} slips, "
            f"at most {last['max_late_us']:.0f} us late."
        )
    if c.flown and not last["work_us"]["max"]:
        text.append("That run was in virtual time, in which work takes none.")
    elif c.flown:
        tasks = [
            (name, f"{t['mean']:.1f}", f"{t['max']:.1f}")
            for name, t in last.get("tasks_us", {}).items()
        ]
        tables.append(Table(head=("task", "mean [us]", "max [us]"), rows=tasks))
        t_s = np.array(times_s([record["t_ns"] for record in c.flown], c.result.start_ns))
        late = np.array([float(record["max_late_us"]) for record in c.flown])
        work = np.array([float(record["work_us"]["max"]) for record in c.flown])
        charts.append(
            Chart(
                title="Timing of the recorded run",
                x_label=TIME,
                y_label="greatest so far [us]",
                x=thinned_axis(t_s),
                lines=[line_of("late", late), line_of("work of a tick", work)],
            )
        )
    text.append(f"The replay took {c.result.wall_s:.1f} s.")
    return Section(title="Timing", text=text, tables=tables, charts=charts)


def configuration(c: Collected) -> Section:
    """Return the section with package versions, metadata of the recording and configuration."""
    held = [
        (f"{name}.{key}", value) for name, data in c.metadata.items() for key, value in data.items()
    ]
    rows = [
        *c.versions.items(),
        *held,
        ("configuration", c.config.name),
        ("CRC-32 of the configuration", f"{c.config.crc32:08x}"),
    ]
    if c.span.words():
        rows.append(("part", c.span.words().strip()))
    source = c.config.source.decode(errors="replace")
    tables = [Table(head=("item", "value"), rows=rows)]
    return Section(title="Configuration and versions", tables=tables, source=source)
