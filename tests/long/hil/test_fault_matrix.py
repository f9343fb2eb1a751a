"""The short form of the fault matrix, its table, and clean runs that must raise nothing."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evidence.fault_matrix import lost, machine, real_bus, run, table, work
from evidence.store import Store
from fsw.messages.findings import Fault
from hil.__main__ import main
from hil.faults.script import TYPES, install
from hil.run import bench
from hil.run.progress import Quiet
from hil.world.scenario import FaultEntry, ScenarioError

BOUNDS = table.load()
SHORT = [row for row in BOUNDS.faults if row.short]
SEED = 2
MACHINE = ("disk_full", "service_killed")


@pytest.fixture(scope="module")
def trunk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any]:
    setup = run.prepare(BOUNDS, SEED, tmp_path_factory.mktemp("trunk"))
    before = run.trunk(BOUNDS, setup)
    return before, run.branch(before, BOUNDS, None)


@pytest.mark.parametrize("row", SHORT, ids=lambda row: row.type)
def test_a_fault_is_told_isolated_and_leaves_no_trace(trunk: Any, row: table.Row) -> None:
    before, clean = trunk
    flown = run.branch(before, BOUNDS, row)
    reference = clean
    if row.loses != "nothing":
        reference = run.branch(before, BOUNDS, row, reference=True)
    values = run.outcome(BOUNDS, row, before.setup, flown, reference, clean)
    assert values["failed"] == [], str(values)


def test_a_branch_is_the_run_from_the_start(trunk: Any) -> None:
    before, _ = trunk
    row = next(row for row in BOUNDS.faults if row.type == "bytes_dropped")
    flown = run.branch(before, BOUNDS, row)
    whole = bench.VirtualRun(before.setup, record=False)
    install([BOUNDS.entry(row)], whole.world, SEED, bench.T0_NS)
    whole.advance(before.setup.total_s, Quiet())
    recorded = whole.finish(Quiet())
    assert np.array_equal(recorded.final.x, flown.final.x)
    assert np.array_equal(recorded.final.covariance, flown.final.covariance)
    assert [e.code for e in recorded.events] == [e.code for e in flown.events]


@pytest.mark.parametrize("seed", range(10, 20))
def test_a_clean_run_raises_no_fault(tmp_path: Any, seed: int) -> None:
    bounds = BOUNDS.model_copy(update={"total_s": 7.0})
    setup = run.prepare(bounds, seed, tmp_path)
    recorded = bench.run_virtual(setup, Quiet(), record=False)
    assert recorded.status["health"]["incidents"] == {}
    assert not {e.code for e in recorded.events} & set(Fault)
    assert len(recorded.blocks) == recorded.status["windows"]["closed"] > 10


def test_the_table_holds_at_least_35_types_and_every_type_of_the_script() -> None:
    types = [row.type for row in BOUNDS.faults]
    assert len(types) == len(set(types)) >= 35
    assert {row.type for row in BOUNDS.of("virtual")} == set(TYPES)
    assert {row.type for row in BOUNDS.of("machine")} == set(machine.lane().acts)
    assert {row.type for row in BOUNDS.of("socketcan")} == set(real_bus.lane().acts)
    assert BOUNDS.total_s - BOUNDS.before_s <= 20.0
    own = {row.event for row in BOUNDS.faults}
    told = own & set(Fault)
    assert len(told) >= 35


def test_bounds_beyond_three_periods_have_a_reason() -> None:
    for row in BOUNDS.faults:
        own_s = BOUNDS.detect_bound_s(row) - BOUNDS.batch_s
        if own_s > 3.0 * BOUNDS.period_s[row.sensor] + 1e-9:
            assert row.reason, row.type


def test_a_recovery_of_its_own_has_a_reason(tmp_path: Path) -> None:
    text = table.PATH.read_text(encoding="utf-8")
    (tmp_path / "table.yaml").write_text(text.replace(", recover_reason: wait", "", 1))
    with pytest.raises(ValueError, match="a recovery of its own, and no reason"):
        table.load(tmp_path / "table.yaml")


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_faults_of_the_machine_are_told_and_leave_no_trace() -> None:
    """When and what else is not asked here: other tests have the machine's processors."""
    command = [sys.executable, "-m", "hil", "faults", "--json"]
    for name in MACHINE:
        command += ["--only", name]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout, done.stderr
    found = json.loads(done.stdout)["faults"]
    assert [values["type"] for values in found] == list(MACHINE), done.stderr
    bounds = {"channels", "valid", "nees", "sigma", "own counter"}
    for values in found:
        assert values["detect_s"] is not None, values
        assert values["recover_s"] is not None, values
        assert not bounds & set(values["failed"]), values


def test_two_rows_have_one_event_only_with_a_reason(tmp_path: Path) -> None:
    text = table.PATH.read_text(encoding="utf-8")
    (tmp_path / "table.yaml").write_text(text.replace("event: TORQUE_RANGE", "event: TORQUE_FAULT"))
    with pytest.raises(ValueError, match="TORQUE_FAULT is another row's too"):
        table.load(tmp_path / "table.yaml")


def test_a_type_that_does_not_exist_is_refused(trunk: Any) -> None:
    entry = FaultEntry(type="gremlins", at_s=1.0, for_s=1.0)
    with pytest.raises(ScenarioError, match="gremlins"):
        install([entry], trunk[0].world, 1, bench.T0_NS)


def test_a_bound_that_does_not_hold_fails_its_row(trunk: Any) -> None:
    before, clean = trunk
    row = next(row for row in BOUNDS.faults if row.type == "frame_drop")
    good = run.outcome(BOUNDS, row, before.setup, clean, clean, clean)
    assert {"detection", "recovery", "own counter"} <= set(good["failed"])
    worse = dataclasses.replace(
        clean, final=dataclasses.replace(clean.final, covariance=2.0 * clean.final.covariance)
    )
    assert "sigma" in run.outcome(BOUNDS, row, before.setup, worse, clean, clean)["failed"]
    surer = dataclasses.replace(
        clean, final=dataclasses.replace(clean.final, covariance=0.8 * clean.final.covariance)
    )
    assert "sigma" in run.outcome(BOUNDS, row, before.setup, surer, clean, clean)["failed"]
    off = dataclasses.replace(clean.final, x=clean.final.x + 8.0 * clean.sigma)
    wrong = dataclasses.replace(clean, final=off)
    assert "nees" in run.outcome(BOUNDS, row, before.setup, wrong, clean, clean)["failed"]


def test_what_a_fault_took_is_left_out_of_the_clean_run_s_recording(tmp_path: Path) -> None:
    bounds = BOUNDS.model_copy(update={"total_s": 7.0, "at_s": 4.0})
    row = next(row for row in BOUNDS.faults if row.type == "bus_cut")
    recordings, finals = {}, {}
    for name in ("clean", "faulty", "reference"):
        setup = run.prepare(bounds, SEED, tmp_path / name)
        flight = bench.VirtualRun(setup, record=True)
        entries = [] if name == "clean" else [bounds.entry(row)]
        install(entries, flight.world, SEED, bench.T0_NS, reference=name == "reference")
        flight.advance(setup.total_s, Quiet())
        finals[name] = flight.finish(Quiet()).final
        recordings[name] = setup.folder / "recording.mcap"
    began_ns = bench.T0_NS + 4_000_000_000
    span_ns = began_ns, began_ns + round(1e9 * (row.for_s or 0.0))
    pair = recordings["clean"], recordings["faulty"]
    end_ns = bench.T0_NS + round(1e9 * setup.total_s)
    result, missing = lost.reference(*pair, setup.config, span_ns, tmp_path, end_ns)
    assert missing == pytest.approx(7 * 500 * (row.for_s or 0.0), abs=7 * 2)
    sigma = np.sqrt(np.diag(result.covariance))
    wanted, clean = (np.sqrt(np.diag(finals[n].covariance)) for n in ("reference", "clean"))
    np.testing.assert_allclose(sigma, wanted, rtol=1e-3)
    assert np.max(sigma / clean) > 1.01
    kept, none = lost.reference(*pair, setup.config, (0, 1), tmp_path, end_ns)
    assert none == 0
    np.testing.assert_allclose(kept.covariance, finals["clean"].covariance, rtol=1e-9)
    early, _ = lost.reference(*pair, setup.config, (0, 1), tmp_path, end_ns - 1_000_000_000)
    assert np.all(np.diag(early.covariance) > 1.01 * np.diag(kept.covariance))


def test_stored_outcomes_are_not_run_again(tmp_path: Any) -> None:
    row = SHORT[0]
    Store(tmp_path, {}).add(work.key(row, 1, "abc"), {"type": row.type, "failed": []})
    assert list(work.outcomes([row], 1, 1, tmp_path, "abc")) == [{"type": row.type, "failed": []}]


def test_an_unknown_fault_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["faults", "--only", "gremlins"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("hil: --only: ['gremlins'] not in ['frame_drop'")
