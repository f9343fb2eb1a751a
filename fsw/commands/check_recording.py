"""`fsw check CONFIG RECORDING`: what a recording says of its configuration."""

from __future__ import annotations

from collections.abc import Callable, Generator
from pathlib import Path

from fsw.checks.mistakes import LARGE, explain_residuals
from fsw.checks.recorded import noise_findings, rate_findings, tracker_findings
from fsw.commands.replay import replay
from fsw.commands.span import WHOLE, Span
from fsw.config import Config
from fsw.estimators.conditioning import Conditioner
from fsw.estimators.model.problem import Problem, joint_order
from fsw.estimators.pipeline import Pipeline
from fsw.estimators.recursive.online import build_online
from fsw.messages import Block, Window

FEW_BLOCKS = 3


class _Watching(Conditioner):
    """Conditioning that keeps what it is given and what it makes of it."""

    def __init__(self, config: Config, order: tuple[int, ...]) -> None:
        super().__init__(config, order)
        self.windows: list[Window] = []
        self.blocks: list[Block] = []

    def stages(self, window: Window) -> Generator[None, None, Block | None]:
        """Keep the window and its block."""
        self.windows.append(window)
        block = yield from super().stages(window)
        if block is not None:
            self.blocks.append(block)
        return block


def check_recording(
    recording: Path,
    config: Config,
    problem: Problem,
    progress: Callable[[str], None],
    span: Span = WHOLE,
) -> tuple[list[str], bool]:
    """Return what the data say of the configuration, a line each, and whether they agree with it.

    Raises
    ------
    ConfigError when the recording does not fit the configuration at all.
    """
    watching = _Watching(config, joint_order(config, problem.model))
    pipeline = Pipeline(conditioner=watching, estimator=build_online(config, problem.model))
    progress("replaying")
    result = replay(recording, config, pipeline=pipeline, span=span)
    lines, wrong = [], 0
    for source, counts in result.status["samples"].items():
        if not counts["accepted"]:
            words = f"{counts['received']} samples, {counts['received_bytes']} bytes received"
            lines.append(f"{source}: WRONG: nothing usable; {words}")
            wrong += 1
    datagrams = result.status["samples"]["imu"]["received"]
    findings = rate_findings(config, watching.windows, datagrams) if watching.windows else []
    if len(watching.blocks) >= FEW_BLOCKS:
        findings += noise_findings(config, watching.windows)
    lines += [finding.text() for finding in findings]
    wrong += sum(bool(finding.wrong) for finding in findings)
    if len(watching.blocks) < FEW_BLOCKS:
        used = f"{len(watching.blocks)} of {len(watching.windows)} windows can be used"
        return [*lines, f"{used}: too few to judge signs and mounting"], False
    verdict = explain_residuals(config, problem, watching.blocks, progress)
    mounted = any(text.startswith("imu") for text in verdict.found)
    turned = (
        [] if mounted else tracker_findings(config, watching.windows)
    )  # it is judged by the gyro
    lines += [f"WRONG: {text}" for text in [*turned, *verdict.found]]
    lines.append(_residual_words(verdict.before, verdict.after, len(verdict.found), verdict.tried))
    return lines, not (wrong or turned or verdict.before > LARGE)


def _residual_words(before: float, after: float, found: int, tried: int) -> str:
    level = f"residuals {before**0.5:.3g} times the declared noise"
    if before <= LARGE:
        return f"signs, order of joints, mounting of the inertial unit: fit ({level})"
    if found:
        return f"{level}, {after**0.5:.3g} times with these changes"
    return (
        f"WRONG: {level}, and none of {tried} usual mistakes explains them; look at the masses of "
        "the links, zero offsets, the lever arm imu.mounting.p_BS_m, delays, the tool frame"
    )
