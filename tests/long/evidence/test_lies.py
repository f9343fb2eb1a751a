"""Sensors that lie slowly: what they do to readings, what the command counts; it resumes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from evidence.lies import KINDS, command
from evidence.lies.case import Case
from evidence.lies.table import SETTLE_S, SIZES, SPAN, VALUES, Lie
from evidence.methods.sensed import Channels
from hil.world.scenario import ScenarioError

T_S = np.arange(0.0, 20.0, 0.01)
ONSET_S = 8.0


def readings() -> Channels:
    """Return two joints that swing, and a base that turns about z by 0.1 rad/s."""
    swing = np.stack([np.sin(T_S), 2.0 * np.cos(T_S)], axis=1)
    three = np.stack([np.sin(T_S), np.cos(T_S), np.sin(2.0 * T_S)], axis=1)
    turn = Rotation.from_rotvec(np.outer(T_S, [0.0, 0.0, 0.1])).as_matrix()
    return Channels(
        t_s=T_S, q_rad=swing, tau_nm=swing, w_NS_S_rad_s=three, f_NS_S_m_s2=three, R_NB=turn
    )


def lie(sensor: str, kind: str, size: float, axis: float | None = 0.0) -> Lie:
    return Lie(sensor=sensor, kind=kind, size=size, axis=axis, onset_s=ONSET_S)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sensor", VALUES)
def test_a_lie_changes_one_sensor_and_nothing_before_its_onset(sensor: str, kind: str) -> None:
    clean = readings()
    lying = lie(sensor, kind, 1e-3).on(clean)
    before = T_S <= ONSET_S
    for name in VALUES.values():
        own, other = getattr(lying, name), getattr(clean, name)
        if name == VALUES[sensor]:
            assert own[before] == pytest.approx(other[before], abs=1e-12)
            assert np.abs(own - other).max() > 1e-5
        else:
            assert own is other


def test_each_kind_has_its_course() -> None:
    """Closed forms; a delay of a sine is the sine of the earlier time."""
    clean, since = readings(), np.maximum(T_S - ONSET_S, 0.0)
    q = clean.q_rad[:, 0]
    offsets = {
        "gain": 0.01 * since * q,
        "zero": 0.01 * (1.0 - np.exp(-since / SETTLE_S)),
        "drift": 0.01 * since,
        "delay": np.sin(T_S - 0.01 * since) - q,
    }
    for kind, offset in offsets.items():
        lying = lie("encoder", kind, 0.01).on(clean).q_rad
        assert lying[:, 0] - q == pytest.approx(offset, abs=2e-5), kind
        assert lying[:, 1] == pytest.approx(clean.q_rad[:, 1], abs=1e-12), kind


def test_a_tracker_drifts_about_one_axis_by_its_rate() -> None:
    clean = readings()
    lying = lie("tracker", "drift", 1e-3, axis=0.5).on(clean)
    off = (Rotation.from_matrix(clean.R_NB).inv() * Rotation.from_matrix(lying.R_NB)).as_rotvec()
    expected = np.outer(1e-3 * np.maximum(T_S - ONSET_S, 0.0), [0.0, 1.0, 0.0])
    assert off == pytest.approx(expected, abs=1e-12)


def test_there_are_two_hundred_lies_of_every_sensor_kind_size_and_doubt() -> None:
    every = command.cases("abc")
    assert len({str(case) for case in every}) == 200
    assert len(every) == len(VALUES) * len(KINDS) * SIZES * 2
    for sensor in VALUES:
        for kind in KINDS:
            sizes = [abs(c.lie.size) for c in every if (c.sensor, c.kind) == (sensor, kind)]
            assert max(sizes) / min(sizes) > SPAN / 6.0
    assert min(case.seed for case in every) >= 1_000_000, "the commit fixes the seeds"
    assert {case.seed for case in command.cases("100")} == {100, 101}
    assert {(c.sensor, c.doubts) for c in command.cases("1", ["gyro", "exact"])} == {
        ("gyro", "exact")
    }


def row(doubts: str, **own: Any) -> dict[str, Any]:
    """Return a row of a harmless lie, changed."""
    same = {"sensor": "gyro", "kind": "gain", "doubts": doubts, "scenario": "base", "seed": 1}
    twin = {"twin_valid": 90, "twin_lost": 10, "twin_refused": 0, "twin_wrong": 0}
    return same | twin | {"valid": 100, "wrong": 0, "harmful": False} | own


def test_the_summary_counts_outputs_and_harmful_lies() -> None:
    found = command.summary(
        [row("exact"), row("exact", wrong=3, harmful=True), row("default", harmful=True)]
    )
    counts = found["counts"]["exact"]
    assert counts["all"] == {"lies": 2, "valid": 200, "wrong": 3, "harmful": 1, "caught": 0}
    assert counts["torque"]["lies"] == 0
    assert found["clean"] == {"outputs": 200, "refused": 0, "wrong": 0, "flights": 2}
    assert not found["passed"], "one of two harmful ones is less than nine of ten"
    assert command.summary([row("exact", wrong=2)] + [row("exact", harmful=True)] * 9)["passed"]
    assert not command.summary([row("default", wrong=1)] + [row("exact", harmful=True)] * 9)[
        "passed"
    ]


def test_the_command_keeps_its_lies_and_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A large gain of all torques of the target's arm: refused, no valid output wrong."""
    given: dict[str, Any] = {
        "only": ["torque", "delay", "exact"],
        "every": 5,
        "seed": 100,
        "jobs": 1,
        "out": tmp_path,
        "as_json": True,
    }
    assert command.run(**given) == 0
    first = capsys.readouterr().out
    assert '"lies": 1' in first

    def never(case: Case) -> dict[str, Any]:
        raise AssertionError(case)

    monkeypatch.setattr(command, "work", never)
    assert command.run(**given) == 0
    assert capsys.readouterr().out == first
    with pytest.raises(ScenarioError, match="below 1000"):
        command.run(**given | {"seed": 1000})
