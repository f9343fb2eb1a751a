"""The mode behind a command, before the loop's summaries know of it."""

from fsw.telemetry.dictionary.codes import Mode
from fsw.telemetry.state.mode_machine import STALE_SUMMARIES, ModeMachine


class Reports:
    def __init__(self) -> None:
        self.told: list[str] = []

    def report(self, name: str, text: str) -> None:
        assert name == "MODE_CHANGED"
        self.told.append(text)


def identifying() -> tuple[ModeMachine, Reports]:
    reports = Reports()
    machine = ModeMachine(reports, safe=False)  # type: ignore[arg-type]
    machine.summary(identifying=True, job=False)
    reports.told.clear()
    return machine, reports


def test_a_summary_from_before_a_command_does_not_undo_it() -> None:
    machine, reports = identifying()
    machine.identifying(False)
    machine.summary(identifying=True, job=False)  # on its way when the command was applied
    assert machine.mode is Mode.STANDBY
    machine.summary(identifying=False, job=False)
    machine.summary(identifying=True, job=False)  # resumed by another way
    assert machine.mode is Mode.IDENTIFY
    assert reports.told == ["IDENTIFY to STANDBY", "STANDBY to IDENTIFY"]


def test_a_loop_that_goes_on_contradicting_is_believed() -> None:
    machine, _ = identifying()
    machine.identifying(False)
    for _ in range(STALE_SUMMARIES):
        machine.summary(identifying=True, job=False)
    assert machine.mode is Mode.STANDBY
    machine.summary(identifying=True, job=False)
    assert machine.mode is Mode.IDENTIFY
