"""The mode behind a command, before the loop's summaries know of it."""

from fsw.telemetry.dictionary.codes import Mode
from fsw.telemetry.state.modes import STALE_SUMMARIES, ModeMachine


class Reports:
    def __init__(self) -> None:
        self.told: list[str] = []

    def report(self, name: str, text: str) -> None:
        assert name == "MODE_CHANGED"
        self.told.append(text)


def identifying() -> tuple[ModeMachine, Reports]:
    reports = Reports()
    modes = ModeMachine(reports, safe=False)  # type: ignore[arg-type]
    modes.summary(identifying=True, job=False)
    reports.told.clear()
    return modes, reports


def test_a_summary_from_before_a_command_does_not_undo_it() -> None:
    modes, reports = identifying()
    modes.identifying(False)
    modes.summary(identifying=True, job=False)  # on its way when the command was applied
    assert modes.mode is Mode.STANDBY
    modes.summary(identifying=False, job=False)
    modes.summary(identifying=True, job=False)  # resumed by another way
    assert modes.mode is Mode.IDENTIFY
    assert reports.told == ["IDENTIFY to STANDBY", "STANDBY to IDENTIFY"]


def test_a_loop_that_goes_on_contradicting_is_believed() -> None:
    modes, _ = identifying()
    modes.identifying(False)
    for _ in range(STALE_SUMMARIES):
        modes.summary(identifying=True, job=False)
    assert modes.mode is Mode.STANDBY
    modes.summary(identifying=True, job=False)
    assert modes.mode is Mode.IDENTIFY
