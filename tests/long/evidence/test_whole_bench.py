"""`hil bench` in its short form: the figures are those of the processes of a real run."""

from contextlib import suppress

import pytest

from evidence.speed.whole import Condition, measure, summary
from hil.run.live import LiveError


class Silent:
    def update(self, done_s: float, summary: object) -> None:
        """Show nothing."""


def measured(name: str, attempts: int = 10) -> Condition:
    """Return a condition; a machine too busy to keep its status fresh is given another chance."""
    for _ in range(attempts - 1):
        with suppress(LiveError):
            return measure("target_leo", name, 6.0, Silent())
    return measure("target_leo", name, 6.0, Silent())


@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ["clients"])
def test_a_run_tells_what_its_processes_took(name: str) -> None:
    condition = measured(name)
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
