"""The whole chain in virtual time on a short stretch, and the pieces that judge it."""

import json
import re

import numpy as np
import pytest
import yaml

from hil.__main__ import main
from hil.judge import judgement, page
from hil.run import bench
from hil.run.progress import describe
from hil.world.scenario import FOLDER, load
from tests.support.small_disk import small_disk

CHI2_20_999 = 45.3  # 99.9 % bound of chi-squared with 20 degrees of freedom


class Silent:
    """A meter that remembers how far it came."""

    def __init__(self):
        self.done_s = 0.0

    def update(self, done_s, summary):  # noqa: ARG002
        self.done_s = done_s


def short(name, folder, duration_s=24.0, seed=1):
    """Return a run of the first seconds of a scenario's motion."""
    import dataclasses

    setup = bench.prepare(load(name), seed, folder)
    length = setup.scenario.before_s + setup.spline.duration_s + setup.scenario.after_s
    cut = dataclasses.replace(
        setup.scenario, after_s=setup.scenario.after_s - (length - duration_s)
    )
    return dataclasses.replace(setup, scenario=cut)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    setup = short("target_leo", tmp_path_factory.mktemp("run"))
    meter = Silent()
    recorded = bench.run_virtual(setup, meter, record=True)
    case = judgement.make_case(setup)
    return setup, case, recorded, judgement.judge(setup, case, recorded), meter


def test_the_target_is_found_within_its_own_uncertainty(run):
    outcome = run[3]
    assert outcome["valid"], outcome["reason"]
    truth, mass = outcome["truth"]["target"]["mass_kg"], outcome["estimate"]["target"]["mass_kg"]
    assert abs(mass / truth - 1) < 0.003
    assert outcome["nees"] < CHI2_20_999
    assert outcome["mass_sigma_to_crb_ratio"]["target"] <= 2.5
    assert outcome["ee_error"]["mean_position_m"] < 3e-4


def test_no_item_is_lost_late_or_rejected(run):
    for source, counters in run[3]["samples"].items():
        assert counters["received"] > 0, source
        assert (counters["lost"], counters["late"], counters["rejected"]) == (0, 0, 0), source
    assert run[3]["slips"] == 0


def test_the_times_of_validity_are_exact_to_a_tenth_of_a_millisecond(run):
    assert run[3]["imu_time_of_validity"]["rms_s"] <= 1e-4


def test_raw_ols_is_biased_on_the_same_data(run):
    assert abs(run[3]["ols"]["mass_error_ratio"]["target"]) > 0.03


def test_the_json_has_the_agreed_words_and_survives_json(run):
    outcome = json.loads(json.dumps(run[3], allow_nan=False))
    agreed = {
        "scenario", "seed", "unknown", "method", "truth", "estimate", "sigma", "ee_error", "nees",
        "dof", "samples", "slips", "wall_s",
    }  # fmt: skip
    assert agreed <= set(outcome)
    for key in ("truth", "estimate", "sigma"):
        body = outcome[key]["target"]
        assert len(body["com_m"]) == 3
        assert len(body["inertia_kg_m2"]) == 6
    words = {"mean_position_m", "max_position_m", "mean_angle_rad", "max_angle_rad"}
    assert set(outcome["ee_error"]) == words
    assert {"received", "lost", "late", "rejected"} == set(outcome["samples"]["imu"])


def test_the_meter_reaches_the_end(run):
    assert run[4].done_s == pytest.approx(run[0].total_s)


def test_the_picture_is_drawn_and_the_torque_residuals_are_noise(run):
    setup, case, recorded, outcome, _ = run
    story = judgement.make_story(setup, case, recorded, outcome)
    assert len(story.points) == len(recorded.estimates)
    residual = story.residuals.torque_nm
    # torque noise of a window, sqrt(4/200) 0.05 N m, and the acceleration noise of 24-bit encoders
    # (5e-5 rad/s2) on a reduced inertia of some hundred kg m2: below one raw sample
    assert np.sqrt(np.mean(residual**2)) < 0.05


def test_the_page_has_the_sections_of_every_report_and_those_of_the_bench(run, tmp_path):
    setup, case, recorded, outcome, _ = run
    story, path = judgement.make_story(setup, case, recorded, outcome), tmp_path / "report.html"
    page.save(story, outcome, judgement.channel_sections(setup, recorded), path)
    found = re.findall("<h2>(.*?)</h2>", path.read_text(encoding="utf-8"))
    found.remove("Tool on the verification trajectory")
    assert found == ["Result", "Estimate over time", "Health and events", "Limits of the accuracy",
                     "Excitation", "Residuals", "Timing", "Configuration and versions"]  # fmt: skip


def test_a_seed_fixes_every_bit(run, tmp_path):
    """The first seconds again: the same estimates after the same windows."""
    again = bench.run_virtual(short("target_leo", tmp_path, 10.0), Silent(), record=False)
    after = {estimate.t_ns: estimate for estimate in run[2].estimates}
    same = [estimate for estimate in again.estimates if estimate.t_ns in after]
    assert len(same) > 10
    for estimate in same[:-1]:  # the last one is settled
        assert np.array_equal(estimate.mean, after[estimate.t_ns].mean)
        assert np.array_equal(estimate.covariance, after[estimate.t_ns].covariance)


def test_the_recording_replays_to_the_same_estimate(run):
    from offline.replay import replay

    setup, _, recorded, _, _ = run
    replayed = replay(setup.folder / "recording.mcap", setup.config)
    scale = np.sqrt(np.diag(recorded.final.covariance))
    difference = (replayed.estimate.mean[: len(scale)] - recorded.final.x) / scale
    np.testing.assert_allclose(difference, 0.0, atol=1e-12)


def test_an_unknown_scenario_is_one_line_and_exit_code_two(capsys):
    assert main(["run", "nothing"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    _, line = captured.err.splitlines()  # after the one that says what is done
    assert line.startswith("hil: no scenario 'nothing'; there are")
    assert main(["seeds", "nothing"]) == 2
    assert capsys.readouterr().err.startswith("hil: no scenario 'nothing'; there are")


def scripted(folder):
    """Return a scenario's file with a fault of its own, from a user's folder."""
    faults = [{"type": "torque_saturated", "at_s": 3.0, "for_s": 0.5, "node_id": 0x13}]
    document = yaml.safe_load((FOLDER / "target_leo.yaml").read_text()) | {"faults": faults}
    path = folder / "mine" / "mine.yaml"
    path.parent.mkdir()
    path.write_text(yaml.safe_dump(document))
    for item in ("robots", "trajectories"):
        (folder / item).symlink_to(FOLDER.parent / item)
    (path.parent / "common").symlink_to(FOLDER / "common")
    return path


def test_a_fault_that_a_scenario_scripts_is_there_and_told(tmp_path):
    path = scripted(tmp_path)
    recorded = bench.run_virtual(short(str(path), tmp_path / "out", 8.0), Silent(), record=False)
    assert recorded.status["health"]["incidents"] == {"TORQUE_OVERLOAD": 1}


def test_a_scripted_fault_in_real_time_is_one_line_and_exit_code_two(tmp_path, capsys):
    path = scripted(tmp_path)
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
    _, line = capsys.readouterr().err.splitlines()
    assert line == "hil: faults: a scenario's own need virtual time: add --fast"


def test_list_names_the_scenarios(capsys):
    assert main(["list"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in ("target_leo", "target_geo", "base", "both"))


def test_the_meter_line_shows_mass_sigma_and_excitation():
    line = describe(
        {
            "estimate": {"target": {"mass_kg": 412.34}},
            "sigma": {"target": {"mass_kg": 1.234}},
            "information_gained_nats": 31.4,
            "valid": False,
            "reason": "NOT_CONVERGED",
        }
    )
    assert line == "target 412.3 ± 1.2 kg · 31 nats · not converged"


def test_a_run_in_virtual_time_has_no_link(capsys):
    assert main(["run", "target_leo", "--fast", "--telemetry", "10025"]) == 2
    assert "--telemetry" in capsys.readouterr().err


def test_a_full_disk_ends_a_run_in_one_line_and_leaves_no_result(tmp_path, capsys):
    with small_disk(tmp_path / "disk", 1 << 19) as disk:
        out = disk / "out"
        assert main(["run", "target_leo", "--fast", "--json", "--out", str(out)]) == 1
        assert not (out / "result.json").exists()
    printed = capsys.readouterr()
    assert printed.out == ""
    (line,) = [line for line in printed.err.splitlines() if "DISK_FULL" in line]
    assert line.startswith("hil: ")
    assert "No space left on device" in line
