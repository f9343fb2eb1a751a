"""Write the result of a batch method as a page, with verdict, residuals and limits."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.errors import ConfigError
from fsw.messages import BodyEstimate, Estimate
from offline.identify import Evidence, noise_text
from offline.report import channel_sections as channels
from offline.report import estimate_sections as estimates
from offline.report.build import sections_of, valid_words
from offline.report.collect import Collected, collected_at
from offline.report.page import page
from offline.report.picture import write_png
from offline.report.tables import write_tables
from offline.report.view import Section, Table, View
from offline.span import Span

NAN = float("nan")


def write_identified(
    values: Mapping[str, Any],
    evidence: Evidence,
    recording: Path,
    config: Config,
    span: Span,
    out: Path,
) -> list[Path]:
    """Write the page `out`, tables (CSV) and, if matplotlib is installed, a picture; return paths.

    Raises
    ------
    ConfigError when a file cannot be written.
    """
    result = replace(
        evidence.replayed,
        estimate=_estimate(values, evidence),
        diagnosis=values["diagnosis"],
        method=values["method"],
        wall_s=values["wall_s"],
    )
    state = evidence.problem, evidence.x, evidence.covariance
    collected = collected_at(recording, span, config, result, evidence.blocks, state)
    shown = view(values, collected, evidence.recursive)
    paths = [out]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(page(shown), encoding="utf-8")
        paths += write_tables(collected, out.with_suffix(""), ["csv"])
        if find_spec("matplotlib") is not None:
            paths.append(out.with_suffix(".png"))
            section = next(one for one in shown.sections if one.title == "Residuals")
            write_png(shown, [chart for chart in section.charts if chart.lines[0].low], paths[-1])
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}") from error
    return paths


def judged(
    reasons: Sequence[str], held_out_passed: bool | None, valid_as: str = "VALID"
) -> tuple[bool, str]:
    """Return validity and headline of a batch result.

    `held_out_passed`: None if no window was held out; `valid_as`: words for a valid result.
    """
    valid = not reasons and held_out_passed is not False
    words = list(reasons)
    if held_out_passed is not None:
        words.append(f"held-out windows {'PASSED' if held_out_passed else 'FAILED'}")
    return valid, f"{valid_as if valid else 'NOT VALID'}{': ' * bool(words)}{', '.join(words)}"


def view(values: Mapping[str, Any], collected: Collected, recursive: Sequence[Estimate]) -> View:
    """Return the page of a batch result; `recursive`: estimates of the replay of its windows."""
    holdout = values.get("holdout")
    passed = None if holdout is None else holdout["passed"]
    valid, verdict = judged(values["reasons"], passed, valid_words(collected))
    result = estimates.result(collected)
    noise = noise_text(values)
    told = [*result.text, *noise, *([values["note"]] if values["note"] else [])]
    sections = [
        replace(result, text=told),
        *([] if holdout is None else [_held_out(holdout)]),
        _over_time(collected, recursive),
        *sections_of(collected),
    ]
    sections.insert(-1, channels.timing(collected))
    unknown = " and ".join(values["unknown"])
    title = f"{collected.name}: {unknown}, method {values['method']}, one batch"
    return View(title=title, verdict=verdict, valid=valid, sections=sections)


def _over_time(collected: Collected, recursive: Sequence[Estimate]) -> Section:
    section = estimates.estimates(replace(collected, estimates=recursive))
    text = "A batch has one estimate, above; this is the recursive one of the same windows."
    return replace(section, text=[text, *section.text])


def _held_out(holdout: Mapping[str, Any]) -> Section:
    keys = ("rms", "rms_over_sigma", "bound", "mean_over_sigma", "mean_bound")
    rows = [
        (name, c["unit"], *(f"{c[key]:.3g}" for key in keys), "yes" if c["passed"] else "NO")
        for name, c in holdout["channels"].items()
    ]
    words = ("rms", "rms / sigma", "bound", "mean / sigma", "bound of the mean")
    table = Table(head=("channel", "unit", *words, "passed"), rows=rows)
    text = [f"{holdout['windows']} windows were predicted and not used."]
    if holdout["prior_only"]:
        text.append(f"Known by the prior alone: {', '.join(holdout['prior_only'])}.")
    return Section(title="Held-out windows", text=text, tables=[table])


def _estimate(values: Mapping[str, Any], evidence: Evidence) -> Estimate:
    """Return the batch result in the form that the online estimator publishes."""
    last = evidence.blocks[-1]
    return Estimate(
        t_ns=int(last.t_ns[-1]),
        reasons=tuple(values["reasons"]),
        method=values["method"],
        names=tuple(values["names"]),
        mean=np.array(values["mean"]),
        covariance=np.array(values["covariance"]),
        bodies={
            name: _body(values["estimate"][name], values["sigma"][name])
            for name in values["estimate"]
        },
        blocks=len(evidence.blocks) - values["gated"],
        gated=values["gated"],
        nis=NAN,
        nis_dof=0,
        condition_number=values["condition_number"],
        information_gained_nats=NAN,
    )


def _body(mean: Mapping[str, Any], sigma: Mapping[str, Any]) -> BodyEstimate:
    return BodyEstimate(
        mass_kg=mean["mass_kg"],
        com_m=np.array(mean["com_m"]),
        inertia_kg_m2=np.array(mean["inertia_kg_m2"]),
        mass_sigma_kg=sigma["mass_kg"],
        com_sigma_m=np.array(sigma["com_m"]),
        inertia_sigma_kg_m2=np.array(sigma["inertia_kg_m2"]),
        physically_consistent=True,
    )
