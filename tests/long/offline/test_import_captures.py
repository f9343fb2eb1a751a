"""`fsw import` of what other tools captured on the wire: the same bytes, so the same estimate.

Bound, set before the first run: logs whose stamps have microseconds give the same bits, because the
bench's CAN stamps are whole microseconds and serial stamps are written with all nine digits.
"""

import io
import json
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import can
import pytest
import yaml

from fsw.__main__ import main
from fsw.exchange.recording import contents, messages
from tests.support.sampled_cases import faults

EPOCH_NS = 1_760_000_000 * 10**9  # as a computer stamps that knows the date


@cache
def logs_of(folder: Path, log: str, epoch_ns: int) -> dict[str, bytes]:
    """Return the files that python-can and a serial logger would write of a recording."""
    path = folder / "recording.mcap"
    with TemporaryDirectory() as name:
        with can.Logger(Path(name) / log) as logger:
            for item in messages(path, ["/can/arm"]):
                word, length = int.from_bytes(item.data[:4], "little"), item.data[4]
                logger.on_message_received(
                    can.Message(
                        timestamp=(item.t_ns + epoch_ns) / 1e9,
                        arbitration_id=word,
                        is_extended_id=False,
                        data=item.data[8 : 8 + length],
                        channel=0,
                    )
                )
        arm = (Path(name) / log).read_bytes()
    rows = [(seconds(m.t_ns + epoch_ns), m.data.hex()) for m in messages(path, ["/serial/imu"])]
    imu = "stamp_s,hex\n" + "".join(f"{t},{data}\n" for t, data in rows)
    tracker = "".join(
        f'{{"stamp_s": {seconds(m.t_ns + epoch_ns)}, "hex": "{m.data.hex()}"}}\n'
        for m in messages(path, ["/serial/star_tracker"])
    )
    return {log: arm, "imu.csv": imu.encode(), "tracker.jsonl": tracker.encode()}


def captured(folder: Path, out: Path, log: str = "arm.log", epoch_ns: int = EPOCH_NS) -> list[str]:
    """Write the logs of a recording into `out`; return the arguments that import them."""
    for name, data in logs_of(folder, log, epoch_ns).items():
        (out / name).write_bytes(data)
    return [
        "import",
        *("--can", f"arm={out / log}", "--serial", f"imu={out / 'imu.csv'}"),
        *("--serial", f"star_tracker={out / 'tracker.jsonl'}"),
        *("--config", str(folder / "flight.yaml"), "--out", str(out / "imported.mcap")),
    ]


def seconds(t_ns: int) -> str:
    return f"{t_ns // 10**9}.{t_ns % 10**9:09d}"


@cache
def identified(recording: Path, folder: Path) -> dict:
    said = io.StringIO()
    with redirect_stdout(said):
        main(["identify", str(recording), "--config", str(folder / "flight.yaml"), "--json"])
    return json.loads(said.getvalue())


@pytest.mark.parametrize("log", ["arm.log", "arm.blf", "arm.asc"])
def test_a_log_written_by_another_tool_gives_the_same_bits(flown, tmp_path, log, capsys):
    assert main(captured(flown, tmp_path, log)) == 0
    said = capsys.readouterr().out
    assert all(topic in said for topic in ("/can/arm", "/serial/imu", "/serial/star_tracker"))
    ours = identified(flown / "recording.mcap", flown)
    theirs = identified(tmp_path / "imported.mcap", flown)
    for key in ("status", "mean", "covariance", "samples"):
        assert theirs[key] == ours[key]
    assert theirs["samples"]["arm"]["accepted"] > 1000


def test_an_imported_recording_carries_its_configuration(flown, tmp_path, capsys):
    assert main(captured(flown, tmp_path)) == 0
    held = contents(tmp_path / "imported.mcap")
    assert {"configuration.yaml", "robot.urdf"} <= set(held.attachments)
    assert held.metadata["import"]["/can/arm"] == "arm.log"
    main(["replay", str(tmp_path / "imported.mcap"), "--json"])
    out = capsys.readouterr().out.splitlines()[-1]
    assert json.loads(out)["samples"]["imu"]["rejected"] == 0


def test_a_log_on_another_clock_is_refused_and_shifted(flown, tmp_path, capsys):
    arguments = captured(flown, tmp_path)
    (tmp_path / "late").mkdir()
    late = captured(flown, tmp_path / "late", epoch_ns=EPOCH_NS + 3600 * 10**9)
    arguments[2] = late[2]
    assert main(arguments) == 2
    assert "one clock" in capsys.readouterr().err
    assert main([*arguments, "--shift", "arm=-3600"]) == 0
    capsys.readouterr()
    ours = identified(flown / "recording.mcap", flown)
    assert identified(tmp_path / "imported.mcap", flown)["mean"] == ours["mean"]


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-7])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def noise(path: Path) -> None:
    path.write_bytes(bytes(range(256)) * 40 + b"\n")


def turned(path: Path) -> None:
    lines = path.read_text().splitlines(keepends=True)
    half = len(lines) // 2
    path.write_text("".join([lines[0], *lines[half:], *lines[1:half]]))


def foreign(path: Path) -> None:
    path.write_text(path.read_text().replace(" 191#", " 1A1#").replace(" 192#", " 1A2#"))


def silent(path: Path) -> None:
    kept = [line for line in path.read_text().splitlines(keepends=True) if " 080#" not in line]
    path.write_text("".join(kept))


def two(path: Path) -> None:
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([lines[0].replace(lines[0].split()[1], "can7"), *lines]))


FAULTS = {
    ("arm.log", cut): "cut off",
    ("arm.log", empty): "empty",
    ("arm.log", noise): "cannot be read as a CAN log",
    ("arm.log", turned): "time runs backwards 1 times",
    ("arm.log", foreign): "nothing of joint1 (node 0x11), joint2 (node 0x12)",
    ("arm.log", silent): "no SYNC frame",
    ("arm.log", two): "has the channels can7, can0",
    ("arm.blf", cut): "arm.blf: ",
    ("arm.blf", empty): "empty",
    ("arm.asc", cut): "cut off",
    ("arm.asc", noise): "arm.asc: ",
    ("imu.csv", cut): "last line is cut off",
    ("imu.csv", empty): "is empty",
    ("imu.csv", noise): "is not text",
    ("imu.csv", turned): "time runs backwards 1 times",
    ("tracker.jsonl", cut): "last line is cut off",
    ("tracker.jsonl", turned): "time runs backwards",
}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault[0]}-{fault[1].__name__}")
def test_a_wrong_file_is_one_line_and_nothing_is_written(flown, tmp_path, fault, capsys):
    name, spoil = fault
    arguments = captured(flown, tmp_path, name if name.startswith("arm") else "arm.log")
    spoil(tmp_path / name)
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert FAULTS[fault] in said.err
    assert (said.out, len(faults(said.err)), "Traceback" in said.err) == ("", 1, False)
    assert not list(tmp_path.glob("imported*"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("--can", "leg=arm.log"), "--can: 'leg' is not in the configuration, which has: arm"),
        (("--serial", "gps=gps.csv"), "--serial: 'gps'"),
        (("--serial", "imu"), "--serial 'imu': must be DEVICE=FILE"),
        (("--shift", "arm=soon"), "--shift: arm=soon: must be seconds"),
        (("--shift", "leg=1"), "--shift: leg"),
    ],
)
def test_a_wrong_argument_is_one_line(flown, tmp_path, change, words, capsys):
    assert main([*captured(flown, tmp_path), *change]) == 2
    said = capsys.readouterr().err
    assert (words in said, len(faults(said))) == (True, 1)
    assert not list(tmp_path.glob("imported*"))


def test_a_sensor_without_a_file_and_a_row_without_bytes_are_named(flown, tmp_path, capsys):
    arguments = captured(flown, tmp_path)
    assert main([*arguments[:3], *arguments[5:]]) == 2
    assert "add --serial imu=FILE" in capsys.readouterr().err
    (tmp_path / "imu.csv").write_text("stamp_s,hex\n1.0,a5\n1.1,zz\n")
    assert main(arguments) == 2
    assert "imu.csv: line 3: stamp_s '1.1', hex 'zz'" in capsys.readouterr().err


def test_a_robot_without_inertial_unit_needs_no_file_of_one(flown, tmp_path, capsys):
    arguments = captured(flown, tmp_path)
    data = yaml.safe_load((flown / "flight.yaml").read_text())
    for section in ("imu", "star_tracker"):
        del data[section]
    data |= {"base": {"motion": "clamped", "gravity_B_m_s2": [0, 0, -9.8]}}
    data["robot"]["urdf"] = str(flown / "robot.urdf")
    config = tmp_path / "clamped.yaml"
    config.write_text(yaml.safe_dump(data))
    out = tmp_path / "imported.mcap"
    assert main([*arguments[:3], "--config", str(config), "--out", str(out)]) == 0
    main(["replay", str(out), "--json"])
    assert list(json.loads(capsys.readouterr().out.splitlines()[-1])["samples"]) == ["arm"]
    assert main(["check", str(config), str(out)]) in (0, 1)
    assert "imu" not in capsys.readouterr().out
