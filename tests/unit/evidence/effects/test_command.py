"""How much there is to do is said before the first run."""

import pytest

from evidence import runner
from evidence.effects.command import SCENARIOS, run


def test_the_number_of_runs_is_printed_before_they_begin(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def begun(*_given: object) -> None:
        raise InterruptedError

    monkeypatch.setattr(runner, "rows", begun)
    with pytest.raises(InterruptedError):
        run(scenarios=[], first=0, count=50, jobs=1, out=None, as_json=False)
    said = capsys.readouterr().err
    assert f"{50 * len(SCENARIOS)} runs: {len(SCENARIOS)} scenarios (wheels_leo, mev, " in said
