"""`fsw report` on a flight in virtual time: page, tables and picture agree with the replay."""

import csv
import json
import os
import re
import threading
from contextlib import contextmanager

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from pyarrow import parquet

from fsw.__main__ import main
from fsw.config import load
from fsw.exchange.recording import messages
from fsw.service.control import SOCKET_NAME, ControlServer
from offline.report.collect import collect
from offline.report.identified import judged

MOST_BYTES = 5_000_000
REST = ["Health and events", "Limits of the accuracy", "Excitation", "Residuals", "Timing",
        "Configuration and versions"]  # fmt: skip
SECTIONS = ["Result", "Estimate over time", *REST]


def sections_of(text):
    return re.findall("<h2>(.*?)</h2>", text)


@pytest.fixture(scope="module")
def reported(flown, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    out = folder / "page.html"
    beside = ["--csv", "--png", "--parquet", "--mcap"]
    return main(["report", str(flown / "recording.mcap"), "--out", str(out), *beside]), out


def rows_of(out, name):
    with out.with_name(f"{out.stem}_{name}.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_files_agree_with_a_replay(flown, reported, capsys):
    code, out = reported
    main(["replay", str(flown / "recording.mcap"), "--json"])
    result = json.loads(capsys.readouterr().out)
    assert code == (0 if result["valid"] else 1)
    text = out.read_text(encoding="utf-8")
    assert len(text) < MOST_BYTES
    verdict = "VALID" if result["valid"] else f"NOT VALID: {result['reason']}"
    assert f">{verdict}</div>" in text
    assert text.index("VALID") < text.index("<h2>"), "the verdict stands first"
    assert sections_of(text) == SECTIONS
    last = rows_of(out, "estimate")[-1]
    assert float(last["target_mass_kg"]) == result["estimate"]["target"]["mass_kg"]
    assert float(last["target_mass_kg_sigma"]) == result["sigma"]["target"]["mass_kg"]
    recorded = [json.loads(m.data) for m in messages(flown / "recording.mcap", ["/events"])]
    assert recorded[-1]["text"] != result["events"][-1]["text"], "ticks of the run, of the replay"
    assert [row["text"] for row in rows_of(out, "events")] == [e["text"] for e in recorded]
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


def test_parquet_and_mcap_hold_the_estimates_of_the_csv(reported):
    out = reported[1]
    rows = rows_of(out, "estimate")
    for name in ("estimate", "residuals", "events"):
        table = parquet.read_table(out.with_name(f"page_{name}.parquet"))
        assert table.column_names == list(rows_of(out, name)[0])
        assert table.num_rows == len(rows_of(out, name))
    masses = [float(row["target_mass_kg"]) for row in rows]
    table = parquet.read_table(out.with_name("page_estimate.parquet"))
    assert table.column("target_mass_kg").to_pylist() == masses
    with out.with_name("page_estimate.mcap").open("rb") as file:
        written = [json.loads(m.data) for _, _, m in make_reader(file).iter_messages()]
    assert [m["inertia"]["m"] for m in written] == pytest.approx(masses, rel=1e-12)
    sigmas = [float(row["target_inertia_xy_kg_m2_sigma"]) for row in rows]
    assert [m["sigma"]["ixy"] for m in written] == pytest.approx(sigmas, rel=1e-9)
    assert [m["valid"] for m in written] == [row["valid"] == "1" for row in rows]
    for layout in ("page_foxglove.json", "page_plotjuggler.xml"):
        assert "/estimate/target" in out.with_name(layout).read_text()


def test_every_chart_has_units_on_both_axes(reported):
    text = reported[1].read_text(encoding="utf-8")
    inside = re.search(r'type="application/json">(.*?)</script>', text, re.S)
    assert inside is not None
    charts = json.loads(inside[1])
    assert len(charts) > 40
    for chart in charts:
        labels = [chart["x_label"], *([] if chart["levels"] else [chart["y_label"]])]
        assert all("[" in label for label in labels), chart["title"]
        assert all(len(line["y"]) == len(chart["x"]) for line in chart["lines"]), chart["title"]


def test_the_page_says_what_valid_means_and_what_is_known_least(reported):
    """Of the shares of sigma in the body's own mass, size and inertia, made here again."""
    out = reported[1]
    row = rows_of(out, "estimate")[-1]
    values = [float(row[key]) for key in row if key.startswith("target_")]
    body, sigma = np.array(values[:10]), np.array(values[10:])
    moment = body[[4, 7, 9]].mean()
    scales = [body[0], *[(moment / body[0]) ** 0.5] * 3, *[moment] * 6]
    share = sigma / scales
    k = int(share.argmax())
    assert k > 3
    axis = ("xx", "xy", "xz", "yy", "yz", "zz")[k - 4]
    text = out.read_text(encoding="utf-8")
    words = f"Known least is target inertia {axis}: 1 sigma {sigma[k]:.2g}"
    assert "Valid means: the data say more than the prior" in text
    assert f"{words} kg m², {100 * share[k]:.2g} % of the mean moment of inertia." in text
    shown = text.partition("<script>")[0]
    assert "±" in shown
    assert "+-" not in shown.partition("<pre>")[0]
    assert 'class="fold"><summary>Curves, spectra and histograms of every channel' in shown


def test_residuals_of_a_right_model_are_those_of_the_stated_noise(reported):
    rows = rows_of(reported[1], "residuals")
    for name in ("rate.x [rad/s]", "specific_force.z [m/s2]", "torque.joint2 [N m]"):
        ratio = np.array([float(row[name]) / float(row[f"{name} sigma"]) for row in rows])
        assert 0.5 < np.sqrt(np.mean(ratio**2)) < 1.3, name


def test_a_cause_is_named_and_too_little_noise_stands_out(flown, tmp_path):
    data = yaml.safe_load((flown / "flight.yaml").read_text())
    for joint in data["joints"]:
        joint["torque_scale_sigma_ratio"] = 0.02
    data["imu"]["velocity_random_walk_m_s_sqrt_s"] /= 3.0
    data["robot"]["urdf"] = str(flown / "robot.urdf")
    (tmp_path / "flight.yaml").write_text(yaml.safe_dump(data))
    collected = collect(flown / "recording.mcap", load(tmp_path / "flight.yaml"))
    shares = collected.shares["target.mass_kg"]
    assert all(0.0 <= share <= 1.0 for share in shares.values())
    assert shares["torque scale"] > 0.5, "one gain of all joints is a mass"
    assert collected.residuals is not None
    force = collected.residuals.names.index("specific_force.x")
    assert np.sqrt(np.nanmean(collected.residuals.normalised[:, force] ** 2)) > 2.0


@contextmanager
def daemon_with(folder, status):
    """Answer at the control socket of a state folder as the service does, for a block."""
    folder.mkdir(exist_ok=True)
    server = ControlServer(folder / SOCKET_NAME, lambda: status, lambda _command: False)
    over = threading.Event()

    def serve() -> None:
        while not over.is_set():
            server.serve(0.02, 0)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        server.close()


def test_a_running_daemon_is_reported_from_its_status_and_its_recording_so_far(
    flown, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(os, "nice", lambda increment: increment)  # else of all tests behind it
    whole = (flown / "recording.mcap").read_bytes()
    growing = tmp_path / "recording_0001.mcap"
    growing.write_bytes(whole[: len(whole) * 3 // 4])
    (tmp_path / "robot.urdf").write_bytes((flown / "robot.urdf").read_bytes())
    config = tmp_path / "flight.yaml"
    config.write_bytes((flown / "flight.yaml").read_bytes())
    *_, newest = messages(growing, ["/tm"])
    status = json.loads(newest.data)
    state = load(config).resolve(load(config).service.state_directory)
    out = tmp_path / "live.html"
    told = ["report", "live", "--config", str(config), "--out", str(out)]
    assert main(told) == 1
    assert "no daemon answers" in capsys.readouterr().err
    with daemon_with(state, status | {"recorder": {"path": str(growing)}}):
        code = main(told)
    printed = capsys.readouterr()
    assert "10 s replayed" in printed.err
    estimate = status["estimate"]
    verdict = "VALID" if estimate["valid"] else f"NOT VALID: {estimate['reason']}"
    assert code == (0 if estimate["valid"] else 1)
    assert re.match(rf"{verdict} after \d+ s\n", printed.out)
    text = out.read_text(encoding="utf-8")
    assert sections_of(text) == ["Now", *SECTIONS]
    now = text[text.index("<h2>Now") : text.index("<h2>Result")]
    assert f'<td class="number">{estimate["estimate"]["target"]["mass_kg"]:.6g}</td>' in now
    assert "the daemon continues it" in now
    assert "cut off" not in text
    growing.write_bytes(whole)  # it ends while the report begins
    with daemon_with(state, status | {"recorder": {"path": str(growing)}}):
        main([*told, "--force", "--to", "5"])
    assert "that was closed when it was read" in out.read_text(encoding="utf-8")


def test_a_daemon_that_records_nothing_and_one_without_configuration_end_in_one_line(
    flown, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert main(["report", "live"]) == 2
    assert "--config" in capsys.readouterr().err
    (tmp_path / "robot.urdf").write_bytes((flown / "robot.urdf").read_bytes())
    (tmp_path / "flight.yaml").write_bytes((flown / "flight.yaml").read_bytes())
    config = load(tmp_path / "flight.yaml")
    with daemon_with(config.resolve(config.service.state_directory), {"t_ns": 1}):
        assert main(["report", "live", "--config", "flight.yaml"]) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("fsw: recorder.directory: ")
    assert not list(tmp_path.glob("*.html"))


def test_a_batch_result_has_a_page_with_its_held_out_windows_and_its_own_residuals(
    flown, tmp_path, capsys
):
    out = tmp_path / "batch.html"
    told = ["--config", str(flown / "flight.yaml"), "--method", "mrnea", "--holdout", "0.3"]
    recording = str(flown / "recording.mcap")
    code = main(["identify", recording, *told, "--json", "--report", str(out)])
    result = json.loads(capsys.readouterr().out)
    text = out.read_text(encoding="utf-8")
    passed = result["holdout"]["passed"]
    verdict = judged(result["reasons"], passed)[1]
    assert f'class="{"valid" if code == 0 else ""}">{verdict}</div>' in text
    assert text.index(verdict) < text.index("<h2>")
    (row,) = rows_of(out, "estimate")
    assert float(row["target_mass_kg"]) == result["estimate"]["target"]["mass_kg"]
    assert float(row["target_com_x_m_sigma"]) == result["sigma"]["target"]["com_m"][0]
    assert sections_of(text) == ["Result", "Held-out windows", *SECTIONS[1:]]
    held = text[text.index("<h2>Held-out windows") : text.index("<h2>Estimate over time")]
    assert "target: mass, with 3 sigma" in text, "over time"
    for name, channel in result["holdout"]["channels"].items():
        number = f'<td class="number">{channel["rms"]:.3g}</td>'
        assert f"<td>{name}</td><td>{channel['unit']}</td>{number}" in held
    rows = rows_of(out, "residuals")
    name = "torque.joint2 [N m]"
    torque = [float(row[name]) / float(row[f"{name} sigma"]) for row in rows]
    assert 0.5 < np.sqrt(np.mean(np.square(torque))) < 1.3
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
