"""A declared sensor of which nothing is used: a warning of every command, never silence.

MicroStrain units are set by their users: GPS time in the place of the reference time, or delta
angles and velocities in the place of rates and accelerations, are customary.
"""

import json
import math
import struct
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from fsw.__main__ import main
from fsw.exchange.recording import messages
from tests.long.offline.test_import_captures import captured
from tests.support.encoders import mip

LENGTH = 42  # of a STIM300 datagram with rates, accelerations and temperatures, and its CRC
TIME, ACC, RATE = 0xD5, 0x04, 0x05
Fields = list[tuple[int, bytes]]


def gps_time(fields: Fields) -> Fields:
    return [(0x12, bytes(12)) if key == TIME else (key, data) for key, data in fields]


def deltas(fields: Fields) -> Fields:
    others = {RATE: 0x07, ACC: 0x08}
    return [(others.get(key, key), data) for key, data in fields]


def no_acceleration(fields: Fields) -> Fields:
    return [(key, data) for key, data in fields if key != ACC]


STREAMS = {
    gps_time: "packets have no reference time (field 0xD5), found 0x04 0x05 0x12",
    deltas: "no rate and acceleration (fields 0x05, 0x04), found 0x07 0x08",
    no_acceleration: "no acceleration (field 0x04), found 0x05",
}


def packets(folder: Path, change: Callable[[Fields], Fields]) -> list[tuple[int, bytes]]:
    """Return the inertial unit of a flight as stamped MIP packets, changed by `change`."""
    data, found, number = b"", [], 0
    for item in messages(folder / "recording.mcap", ["/serial/imu"]):
        data += item.data
        while len(data) >= LENGTH and (start := data.find(b"\xa5")) >= 0:
            datagram, data = data[start : start + LENGTH], data[start + LENGTH :]
            if len(datagram) < LENGTH:
                break
            readings = [
                int.from_bytes(datagram[at : at + 3], "big", signed=True)
                for at in (1, 4, 7, 11, 14, 17)
            ]
            rate = [math.radians(x * 2.0**-14) for x in readings[:3]]
            force = [x * 2.0**-19 for x in readings[3:]]
            fields = [
                (TIME, struct.pack(">Q", 10**9 + number * 8_000_000)),
                (ACC, struct.pack(">3f", *force)),
                (RATE, struct.pack(">3f", *rate)),
            ]
            found.append((item.t_ns, mip(change(fields))))
            number += 1
    return found


@pytest.fixture(params=STREAMS, ids=lambda change: change.__name__)
def stream(request, flown, tmp_path, capsys) -> tuple[Path, Path, str, str]:
    """Return a recording of a changed stream, its configuration, the words, what import said."""
    arguments = captured(flown, tmp_path)
    epoch_ns = 1_760_000_000 * 10**9
    rows = [
        f"{(t_ns + epoch_ns) // 10**9}.{(t_ns + epoch_ns) % 10**9:09d},{data.hex()}\n"
        for t_ns, data in packets(flown, request.param)
    ]
    assert len(rows) > 1000
    (tmp_path / "imu.csv").write_text("stamp_s,hex\n" + "".join(rows))
    data = yaml.safe_load((flown / "flight.yaml").read_text())
    data["robot"]["urdf"] = str(flown / data["robot"]["urdf"])
    data["imu"]["driver"] = "mip"
    config = tmp_path / "mip.yaml"
    config.write_text(yaml.safe_dump(data))
    arguments[arguments.index("--config") + 1] = str(config)
    assert main(arguments) == 0
    said = capsys.readouterr()
    return tmp_path / "imported.mcap", config, STREAMS[request.param], said.out + said.err


def test_every_command_warns_of_it(stream, tmp_path, capsys):
    recording, config, words, imported = stream
    assert words in imported
    both = [str(recording), "--config", str(config)]
    for command in (
        ["check", str(config), str(recording)],
        ["identify", *both],
        ["replay", *both],
        ["report", *both, "--out", str(tmp_path / "page.html")],
    ):
        main(command)
        said = capsys.readouterr()
        assert words in said.out + said.err, command[0]
    assert words in (tmp_path / "page.html").read_text()
    for command in ("identify", "replay"):
        assert main([command, *both, "--json"]) == 0  # rows of the unit are left out
        result = json.loads(capsys.readouterr().out)
        assert [line for line in result["warnings"] if words in line]
    silent = [event["text"] for event in result["events"] if event["code"] == "IMU_SILENT"]
    assert bool(silent) != words.startswith("no acceleration")  # as the daemon raises it
    assert all(words in text for text in silent)


def test_a_method_that_needs_the_sensor_fails_and_says_so(stream, capsys):
    recording, config, words, _ = stream
    if words.startswith("no acceleration"):
        pytest.skip("the momentum comes from the gyro alone")
    both = [str(recording), "--config", str(config), "--method", "cm"]
    for command in ("identify", "replay"):
        assert main([command, *both]) == 1
        (line,) = [own for own in capsys.readouterr().err.splitlines() if "needs it" in own]
        assert words in line
        assert "estimator.method cm" in line
