"""`hil bench` in its short form: the figures are those of the processes of a real run."""

import pytest

from hil.evidence.speed.whole import measure, summary


class Silent:
    def update(self, done_s: float, summary: object) -> None:
        """Show nothing."""


@pytest.mark.parametrize("name", ["clients"])
def test_a_run_tells_what_its_processes_took(name: str) -> None:
    condition = measure("target_leo", name, 6.0, Silent())
    assert 4.0 < condition.seconds <= 7.0
    assert set(condition.core_percent) == {"loop", "estimation", "plant", "service"}
    assert all(0.0 < share < 100.0 for share in condition.core_percent.values())
    assert all(10.0 < size < 1000.0 for size in condition.resident_mb.values())
    grid = condition.seconds * 500.0
    assert condition.ticks + condition.slips == pytest.approx(grid, rel=0.1)
    assert 0.0 < condition.work_mean_us <= condition.work_p99_us
    assert condition.release_p99_us > 0.0
    assert condition.published_p99_us > 0.0
    assert condition.dropped == 0
    assert f"{name}: loop [% of a core]" in summary([[condition]])
