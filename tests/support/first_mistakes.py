"""Mistakes of a first try that a command finds before it reads any data: what is typed then.

Each one changes the robot or the configuration of `ArmProject`, or writes a file beside them.
"""

from collections.abc import Callable, Mapping
from typing import Any

import yaml

from tests.conftest import ArmProject

JOINTS = [f"axis{k}" for k in range(1, 4)]
HEADER = ",".join(["t", *(f"{kind}_{name}" for name in JOINTS for kind in ("q", "tau"))])
ROWS = [",".join([f"{0.01 * k:.2f}", *[f"{0.001 * k:.3f}"] * 6]) for k in range(20)]
MAPPING: dict[str, Any] = {
    "joints": {
        "time": {"column": "t", "unit": "s"},
        "position": {"columns": "q_{}", "unit": "rad"},
        "torque": {"columns": "tau_{}", "unit": "N m"},
    }
}
Typed = Callable[[ArmProject], list[str]]


def section(name: str, **values: Any) -> Typed:
    """Return a mistake in one section of the configuration, the first one of a list."""

    def typed(arm: ArmProject) -> list[str]:
        own = arm.data[name]
        (own[0] if isinstance(own, list) else own).update(values)
        return ["check", str(arm.write())]

    return typed


def prior(**values: Any) -> Typed:
    def typed(arm: ArmProject) -> list[str]:
        arm.data["bodies"]["target"].update(values)
        return ["check", str(arm.write())]

    return typed


def whole(**values: Any) -> Typed:
    def typed(arm: ArmProject) -> list[str]:
        arm.data.update(values)
        return ["check", str(arm.write())]

    return typed


def urdf(old: str, new: str) -> Typed:
    def typed(arm: ArmProject) -> list[str]:
        assert old in arm.urdf
        arm.urdf = arm.urdf.replace(old, new, 1)
        return ["check", str(arm.write())]

    return typed


def text(change: Callable[[str], str | bytes]) -> Typed:
    """Return a mistake in the text of the configuration."""

    def typed(arm: ArmProject) -> list[str]:
        path = arm.write()
        changed = change(path.read_text())
        path.write_bytes(changed.encode() if isinstance(changed, str) else changed)
        return ["check", str(path)]

    return typed


def sdf(arm: ArmProject) -> list[str]:
    arm.urdf = '<sdf version="1.7"><model name="arm"/></sdf>'
    return ["check", str(arm.write())]


def no_imu(arm: ArmProject) -> list[str]:
    del arm.data["imu"]
    return ["check", str(arm.write())]


def other(command: str, name: str, content: bytes, *more: str) -> Typed:
    """Return a command on a file of another kind; the configuration is the arm's."""

    def typed(arm: ArmProject) -> list[str]:
        path = arm.folder / name
        path.write_bytes(content)
        return [command, str(path), *(word.format(config=arm.write()) for word in more)]

    return typed


def table_for_log(arm: ArmProject) -> list[str]:
    path = arm.folder / "arm.csv"
    path.write_text(f"{HEADER}\n0,1,2,3,4,5,6\n")
    return ["check", str(arm.write()), str(path)]


def words(*typed: str) -> Typed:
    """Return a command in which the configuration, the URDF and the folder have their names."""

    def made(arm: ArmProject) -> list[str]:
        names = {"config": arm.write(), "urdf": arm.folder / "arm.urdf", "folder": arm.folder}
        return [word.format(**names) for word in typed]

    return made


def imported(
    change: Callable[[list[str]], list[str]] = lambda rows: rows,
    content: bytes | None = None,
    mapping: Mapping[str, Any] = {},
) -> Typed:
    """Return a mistake in a table, or in the mapping of its joints."""

    def typed(arm: ArmProject) -> list[str]:
        table, path, config = arm.folder / "arm.csv", arm.folder / "map.yaml", arm.write()
        lines = "\n".join(change([HEADER, *ROWS])) + "\n"
        table.write_bytes(lines.encode() if content is None else content)
        own = {"joints": MAPPING["joints"] | mapping}
        path.write_text(yaml.safe_dump(own))
        given = ["--map", str(path), "--config", str(config)]
        return ["import", str(table), *given, "--out", str(arm.folder / "out.mcap")]

    return typed


def link(*typed: str) -> Typed:
    return words("import", *typed, "--config", "{config}", "--out", "{folder}/out.mcap")


def init(tool: str, out: str) -> Typed:
    unknown = "--unknown", "target", "--target-mass-kg", "30"
    return words("init", "{urdf}", "--tool", tool, *unknown, "--out", out)


CONFIGURATION: dict[str, Typed] = {
    "empty configuration": text(lambda _: ""),
    "sections as a list": text(lambda _: "- robot\n- joints\n"),
    "bracket that is not closed": text(lambda own: "buses: [\n" + own),
    "file saved in Latin-1": text(
        lambda own: own.encode() + "# Gr\u00f6\u00dfe\n".encode("latin-1")
    ),
    "section written twice": text(lambda own: own + "scheduler: {tick_rate_hz: 100.0}\n"),
    "unit in a value": section("imu", rate_hz="500 Hz"),
    "decimal comma": section("joints", torque_noise_nm="0,05"),
    "three moments for an inertia": prior(inertia_kg_m2=[6.0, 5.0, 4.0]),
    "inertia as a matrix": prior(inertia_kg_m2=[[6, 0, 0], [0, 5, 0], [0, 0, 4]]),
    "inertia that no body has": prior(inertia_kg_m2=[6.0, 0.0, 0.0, 1.0, 0.0, 1.0]),
    "noise of zero": section("joints", torque_noise_nm=0.0),
    "unknown body without a prior": whole(unknown=["payload"]),
    "unknown as a word": whole(unknown="target"),
    "joint on a bus that is not there": section("joints", bus="can0"),
    "interface misspelt": section("buses", interface="socketCAN"),
    "driver misspelt": section("imu", driver="stim-300"),
    "bit rate in kbit/s": section("buses", bitrate=1000),
    "delay in ms": section("imu", gyro_group_delay_s=2.2),
    "rate in kHz": section("imu", rate_hz=0.5),
    "lever arm in mm": section(
        "imu", mounting={"p_BS_m": [200.0, 0.0, 0.0], "q_BS_xyzw": [0.0, 0.0, 0.0, 1.0]}
    ),
    "inertial unit left out": no_imu,
}
ROBOT: dict[str, Typed] = {
    "web page in place of the URDF": urdf("<robot", "<!DOCTYPE html><robot"),
    "SDF in place of the URDF": sdf,
    "link without a joint": urdf("</robot>", '<link name="lost"/></robot>'),
    "two links of one name": urdf("</robot>", '<link name="link1"/></robot>'),
    "decimal comma in the URDF": urdf('xyz="0 0 0.4"', 'xyz="0 0 0,4"'),
    "negative mass": urdf('mass value="3"', 'mass value="-3"'),
    "axis of length zero": urdf('axis xyz="0 0 1"', 'axis xyz="0 0 0"'),
    "no URDF at the path": section("robot", urdf="nosuch.urdf"),
}
FILES: dict[str, Typed] = {
    "table in place of the recording": other(
        "identify", "arm.csv", HEADER.encode(), "--config", "{config}"
    ),
    "table in place of the log": table_for_log,
    "bag in place of the recording": words("identify", "{folder}", "--config", "{config}"),
    "recording that is not there": words("identify", "none.mcap", "--config", "{config}"),
    "result into a folder that is not there": words(
        "identify", "a.mcap", "--config", "{config}", "--out", "{folder}/none/result.json"
    ),
    "file that exists": init("gripper", "{config}"),
    "tool frame misspelt": init("grippr", "{folder}/robot.yaml"),
    "configuration in place of a result": words("export", "{config}", "--format", "urdf"),
    "no daemon runs": words("ctl", "{config}", "status"),
    "motion without limits": words("excite", "{config}", "--out", "{folder}/plan.yaml"),
}
TABLES: dict[str, Typed] = {
    "table without a header": imported(lambda rows: rows[1:]),
    "table without rows": imported(lambda rows: rows[:1]),
    "workbook of a table program": imported(content=b"PK\x03\x04" + bytes(64)),
    "row of units unlike the mapping": imported(
        lambda rows: [rows[0], "[s]" + ",[deg]" * 6, *rows[1:]]
    ),
    "dates as times": imported(
        lambda rows: [rows[0], *("2026-11-27 10:00:00" + row[4:] for row in rows[1:])]
    ),
    "rows in reverse": imported(lambda rows: [rows[0], *rows[:0:-1]]),
    "column misspelt": imported(mapping={"position": {"columns": "pos_{}", "unit": "rad"}}),
    "unit of a column unknown": imported(mapping={"torque": {"columns": "tau_{}", "unit": "Nm"}}),
    "bus left out of --can": link("--can", "arm.log"),
    "bus of --can misspelt": link("--can", "leg=arm.log"),
    "log that is not there": link("--can", "arm={folder}/none.log"),
    "shift with a unit": link("--shift", "imu=10ms"),
}
MADE = CONFIGURATION | ROBOT | FILES | TABLES
