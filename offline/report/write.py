"""Write a report: one replay, one page and the requested further files."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fsw.config import Config
from fsw.errors import ConfigError
from offline.parquet import require_pyarrow
from offline.replay_result import ReplayResult
from offline.report.build import view
from offline.report.collect import Collected, Progress, collect
from offline.report.layouts import foxglove, plotjuggler
from offline.report.page import page
from offline.report.picture import write_png
from offline.report.series import write_series
from offline.report.tables import write_tables
from offline.span import WHOLE, Span

ESTIMATE = "Estimate over time"


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Written:
    """The files of a report, the page first, and the result it shows."""

    paths: tuple[Path, ...]
    verdict: str
    valid: bool  # whether the estimate may be used
    result: ReplayResult

    def __repr__(self) -> str:
        return "\n".join([self.verdict, *map(str, self.paths)])


def write_report(
    recording: Path,
    config: Config,
    out: Path,
    *,
    span: Span = WHOLE,
    with_csv: bool = False,
    with_png: bool = False,
    with_parquet: bool = False,
    with_mcap: bool = False,
    daemon: Mapping[str, Any] | None = None,
    progress: Progress = lambda _text: None,
) -> Written:
    """Replay a recording and write its report; `daemon`: status of the daemon for a live report.

    Raises
    ------
    ConfigError when recording and configuration do not fit, or a file cannot be written.
    """
    if with_parquet:
        require_pyarrow()  # fail before the replay, which is slow
    collected = collect(recording, config, span, daemon, progress)
    progress("drawing")
    shown = view(collected)
    paths = [out]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(page(shown), encoding="utf-8")
        kinds = [kind for kind, on in (("csv", with_csv), ("parquet", with_parquet)) if on]
        paths += write_tables(collected, out.with_suffix(""), kinds)
        if with_mcap:
            paths += _write_mcap(collected, out.with_suffix(""))
        if with_png:
            paths.append(out.with_suffix(".png"))
            section = next(one for one in shown.sections if one.title == ESTIMATE)
            write_png(shown, section.charts, paths[-1])
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}") from error
    return Written(
        paths=tuple(paths), verdict=shown.verdict, valid=shown.valid, result=collected.result
    )


def _write_mcap(collected: Collected, stem: Path) -> list[Path]:
    """Write the estimate over time and layouts for Foxglove and PlotJuggler; return the paths."""
    bodies = collected.result.unknown
    mcap = stem.with_name(f"{stem.name}_estimate.mcap")
    write_series(collected.estimates, bodies, mcap)
    texts = {
        stem.with_name(f"{stem.name}_foxglove.json"): foxglove(bodies),
        stem.with_name(f"{stem.name}_plotjuggler.xml"): plotjuggler(bodies, mcap.name),
    }
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    return [mcap, *texts]
