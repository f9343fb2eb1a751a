"""A report on the disk: one replay, one page, and what was asked for beside it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fsw.commands.replay_result import ReplayResult
from fsw.commands.report.build import view
from fsw.commands.report.collect import collect
from fsw.commands.report.page import page
from fsw.commands.report.tables import write_csv, write_png
from fsw.commands.span import WHOLE, Span
from fsw.config import Config
from fsw.messages.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class Written:
    """The files of a report, the page first, and the result it shows."""

    paths: tuple[Path, ...]
    verdict: str
    result: ReplayResult

    @property
    def valid(self) -> bool:
        """Whether the estimate may be used."""
        return self.result.estimate is not None and self.result.estimate.valid


def write_report(
    recording: Path,
    config: Config,
    out: Path,
    *,
    span: Span = WHOLE,
    with_csv: bool = False,
    with_png: bool = False,
) -> Written:
    """Replay a recording and write its report.

    Raises
    ------
    ConfigError when recording and configuration do not fit, or nothing can be written.
    """
    collected = collect(recording, config, span)
    shown = view(collected)
    paths = [out]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(page(shown), encoding="utf-8")
        if with_csv:
            paths += write_csv(collected, out.with_suffix(""))
        if with_png:
            paths.append(out.with_suffix(".png"))
            write_png(shown, paths[-1])
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}") from error
    return Written(paths=tuple(paths), verdict=shown.verdict, result=collected.result)
