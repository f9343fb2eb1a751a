"""`fsw init --bus`, `--eds`, `--feed` propose the mapping that is true here."""

import struct
from pathlib import Path

import numpy as np
import pytest
import yaml

from fsw.__main__ import main
from fsw.config import Config, load
from offline.check_log import frame_findings
from tests.conftest import arm_urdf

CLAMPED = "--tool gripper --unknown target --target-mass-kg 2 --base clamped --tracker none"
FLAGS = f"{CLAMPED} --imu none"
HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: A\n'
RATE_HZ, COUNT = 100.0, 400


def one_message(number: int, *, shift: int = 0) -> str:
    """Return a message with everything; what is commanded comes first and has the same units."""
    return f"""
BO_ {0x300 + number} Drive{number}_Command: 8 A
 SG_ Position_Target : 0|32@1- (0.0001,0) [0|0] "deg" A
 SG_ Torque_Target : 32|16@1- (0.01,0) [0|0] "Nm" A

BO_ {0x200 + number} Drive{number}_Status: 8 A
 SG_ Angle : {shift}|32@1- (0.0001,0) [0|0] "deg" A
 SG_ Torque : 32|16@1- (0.01,0) [0|0] "Nm" A
 SG_ Speed : 48|16@1- (0.01,0) [0|0] "deg/s" A
"""


def two_messages(number: int) -> str:
    return (
        f"""
BO_ {number << 5 | 9} Axis{number}_Get_Encoder_Estimates: 8 A
 SG_ Vel_Estimate : 32|32@1- (1,0) [0|0] "rev/s" A
 SG_ Pos_Estimate : 0|32@1- (1,0) [0|0] "rev" A

BO_ {number << 5 | 28} Axis{number}_Get_Torques: 8 A
 SG_ Torque_Target : 0|32@1- (1,0) [0|0] "Nm" A
 SG_ Torque_Estimate : 32|32@1- (1,0) [0|0] "Nm" A

BO_ {number << 5 | 13} Axis{number}_Set_Input_Vel: 8 A
 SG_ Input_Vel : 0|32@1- (1,0) [0|0] "rev" A
"""
        + "".join(
            f"SIG_VALTYPE_ {number << 5 | word} {name} : 1;\n"
            for word, name in (
                (9, "Vel_Estimate"), (9, "Pos_Estimate"), (28, "Torque_Target"),
                (28, "Torque_Estimate"), (13, "Input_Vel"),
            )
        )
    )  # fmt: skip


def motion(joint: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times [s], angles [rad] and torques [N m] of a joint that swings by 0.3 rad."""
    rng = np.random.default_rng(joint)
    t = (np.arange(COUNT) + 0.3 * joint) / RATE_HZ
    q = 0.3 * np.sin(2.0 * t + joint) + 1e-5 * rng.normal(size=COUNT)
    return t, q, 10.0 * np.cos(q) + 0.1 * rng.normal(size=COUNT)


def in_one(number: int, q: float, tau: float) -> list[tuple[int, bytes]]:
    angle = round(np.degrees(q) * 1e4)
    return [(0x200 + number, struct.pack("<ihh", angle, round(tau * 100), 0))]


def in_two(number: int, q: float, tau: float) -> list[tuple[int, bytes]]:
    return [
        (number << 5 | 9, struct.pack("<ff", q / np.pi / 2, 0.0)),
        (number << 5 | 28, struct.pack("<ff", 0.0, tau)),
    ]


def candump(path: Path, numbers: list[int], encode) -> Path:
    lines = []
    for joint, number in enumerate(numbers):
        for t, q, tau in zip(*motion(joint), strict=True):
            for k, (word, data) in enumerate(encode(number, q, tau)):
                at = 1.7e9 + t + 2e-4 * (k + 1)
                lines.append((at, f"({at:.6f}) can0 {word:03X}#{data.hex().upper()}\n"))
    path.write_text("".join(line for _, line in sorted(lines)))
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "arm.urdf").write_text(arm_urdf(3))
    return tmp_path


def made(folder: Path, *words: str) -> int:
    out = str(folder / "robot.yaml")
    return main(["init", str(folder / "arm.urdf"), *FLAGS.split(), "--out", out, *words])


def mapping(config: Config) -> list[tuple[str, str]]:
    """Return message and signal of every joint's position and torque, in order."""
    return [
        (own.message, own.signal)
        for joint in config.joints
        for own in (joint.signals["position"], joint.signals["torque"])
    ]


CASES = {
    "one": (
        one_message,
        in_one,
        lambda n: [(f"Drive{n}_Status", "Angle"), (f"Drive{n}_Status", "Torque")],
    ),
    "two": (
        two_messages,
        in_two,
        lambda n: [
            (f"Axis{n}_Get_Encoder_Estimates", "Pos_Estimate"),
            (f"Axis{n}_Get_Torques", "Torque_Estimate"),
        ],
    ),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("has_log", [False, True])
def test_a_dbc_is_mapped_by_names_units_and_what_is_in_the_log(folder, capsys, case, has_log):
    """The file describes five drives; those of the log are the last three."""
    message, encode, expected = CASES[case]
    (folder / "robot.dbc").write_text(HEAD + "".join(map(message, range(1, 6))))
    numbers = [3, 4, 5] if has_log else [1, 2, 3]
    log = candump(folder / "candump.log", [3, 4, 5], encode)
    words = ("--recording", str(log)) if has_log else ()
    assert made(folder, "--bus", f"arm={folder / 'robot.dbc'}", *words) == 0
    config = load(folder / "robot.yaml")
    assert mapping(config) == [own for n in numbers for own in expected(n)]
    assert main(["check", str(folder / "robot.yaml")]) == 0
    assert config.buses[0].listen_only
    assert (folder / "robot.yaml").read_text().count("# CHECK") > 6
    if not has_log:
        return
    assert config.buses[0].rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    for joint in config.joints:  # the noise of a known world, within a third
        assert joint.torque_noise_nm == pytest.approx(0.1, rel=0.33)
        assert joint.position_noise_rad == pytest.approx(1e-5, rel=0.33)
    lines, agree = frame_findings(log, config)
    assert agree, lines
    out = folder / "out.mcap"
    words = ["--can", f"arm={log}", "--config", str(folder / "robot.yaml"), "--out", str(out)]
    capsys.readouterr()
    assert main(["import", *words]) == 0
    said = "".join(capsys.readouterr())
    assert said.count(f": {COUNT} samples") == 3, said


def test_a_log_that_contradicts_the_proposal_is_said_so(folder, capsys):
    """The description puts the angle one byte too far: what is read jumps."""
    text = HEAD + "".join(one_message(n).replace("0|32@1-", "7|32@0-") for n in (1, 2, 3))
    (folder / "robot.dbc").write_text(text)
    log = candump(folder / "candump.log", [1, 2, 3], in_one)
    assert made(folder, "--bus", f"arm={folder / 'robot.dbc'}", "--recording", str(log)) == 0
    assert "Drive1_Status.Angle jumps" in capsys.readouterr().out


def test_joints_of_a_dbc_are_found_by_their_names(folder):
    order = ("axis2", "axis3", "axis1")
    text = HEAD + "".join(
        one_message(n).replace(f"Drive{n}_Status", f"{name.upper()}_Status")
        for n, name in enumerate(order, start=1)
    )
    (folder / "robot.dbc").write_text(text)
    assert made(folder, "--bus", f"arm={folder / 'robot.dbc'}") == 0
    found = [message for message, signal in mapping(load(folder / "robot.yaml"))]
    assert found[::2] == ["AXIS1_Status", "AXIS2_Status", "AXIS3_Status"]


def test_a_rail_without_a_torque_has_no_force(folder, capsys):
    drives = "".join(map(one_message, (1, 2, 3))).replace("Torque :", "Load :")
    (folder / "robot.dbc").write_text(
        HEAD + drives.replace('(0.01,0) [0|0] "Nm"', '(1,0) [0|0] "V"')
    )
    urdf = folder / "arm.urdf"
    urdf.write_text(urdf.read_text().replace('"revolute"', '"prismatic"', 1))
    assert made(folder, "--bus", f"arm={folder / 'robot.dbc'}") == 0, capsys.readouterr().err
    assert {joint.torque for joint in load(folder / "robot.yaml").joints} == {"none"}


def test_a_current_is_a_torque_of_the_motor(folder):
    text = "".join(one_message(n).replace('"Nm"', '"A"') for n in (1, 2, 3))
    (folder / "robot.dbc").write_text(HEAD + text.replace(" Torque ", " Iq_Measured "))
    assert made(folder, "--bus", f"arm={folder / 'robot.dbc'}") == 0
    joint = load(folder / "robot.yaml").joints[0]
    assert joint.torque == "motor_current"
    assert joint.signals["torque"].signal == "Iq_Measured"
    assert "nm_per_a: 1.0}  # CHECK" in (folder / "robot.yaml").read_text()


EDS = """[FileInfo]
FileName=drive.eds
[DeviceInfo]
VendorName=nobody
[MandatoryObjects]
SupportedObjects=1
1=0x1000
"""


def variable(index: str, name: str, kind: int, default: str = "0") -> str:
    text = f"\n[{index}]\nParameterName={name}\nObjectType=0x7\nDataType=0x{kind:04X}\n"
    return text + f"AccessType=rw\nDefaultValue={default}\nPDOMapping=1\n"


def record(index: str, values: list[tuple[int, str]]) -> str:
    text = f"\n[{index}]\nParameterName=PDO\nObjectType=0x9\nSubNumber={len(values)}\n"
    return text + "".join(
        variable(f"{index}sub{k}", f"entry {k}", kind, value)
        for k, (kind, value) in enumerate(values)
    )


def eds() -> str:
    """Return a drive that sends status, position and torque in TPDO1, its demands in TPDO2."""
    mapped = {
        "1A00": ["0x60410010", "0x60640020", "0x60770010"],
        "1A01": ["0x60620020", "0x60740010"],
    }
    text = EDS + variable("1000", "Device type", 7)
    for name, kind, index in (
        ("Statusword", 6, "6041"), ("Position actual value", 4, "6064"),
        ("Torque actual value", 3, "6077"), ("Position demand value", 4, "6062"),
        ("Torque demand", 3, "6074"),
    ):  # fmt: skip
        text += variable(index, name, kind)
    for k in range(len(mapped)):
        cob = f"$NODEID+0x{0x180 + 0x100 * k:X}"
        text += record(f"{0x1800 + k:X}", [(5, "2"), (7, cob), (5, "1")])
    for index, entries in mapped.items():
        text += record(index, [(5, f"{len(entries)}"), *((7, entry) for entry in entries)])
    return text


def test_an_eds_is_mapped_by_the_names_of_its_objects(folder, capsys):
    (folder / "drive.eds").write_text(eds())
    assert made(folder, "--eds", str(folder / "drive.eds"), "--first-node", "5") == 0
    config = load(folder / "robot.yaml")
    assert mapping(config) == [("TPDO1", "0x6064"), ("TPDO1", "0x6077")] * 3
    assert [joint.node_id for joint in config.joints] == [5, 6, 7]
    assert (config.joints[0].signals["status"].mask, config.joints[0].torque) == (
        0xC, "motor_current",
    )  # fmt: skip
    assert (config.buses[0].sync, config.buses[0].sync_counter_max) == ("producer", 0)
    assert main(["check", str(folder / "robot.yaml")]) == 0, capsys.readouterr().err


@pytest.mark.parametrize("effort", ["0", "1e16"])
def test_a_rated_torque_is_guessed_where_the_urdf_has_none(folder, effort):
    urdf = arm_urdf(3).replace('effort="50"', f'effort="{effort}"')
    (folder / "arm.urdf").write_text(urdf)
    (folder / "drive.eds").write_text(eds())
    assert made(folder, "--eds", str(folder / "drive.eds")) == 0
    assert load(folder / "robot.yaml").joints[0].signals["torque"].rated_torque_nm == 1000.0


def test_a_step_that_cannot_be_is_no_noise(folder):
    text = "".join(one_message(n).replace("(0.0001,0)", "(1000,0)") for n in (1, 2, 3))
    (folder / "robot.dbc").write_text(HEAD + text)
    assert made(folder, "--bus", f"arm={folder / 'robot.dbc'}") == 0
    assert load(folder / "robot.yaml").joints[0].position_noise_rad == 0.1


def test_a_bus_yml_gives_nodes_mapping_and_scale(folder, capsys):
    """Its mapping replaces the file's: the position is in TPDO2, the torque is not sent."""
    (folder / "drive.eds").write_text(eds())
    mapping_of_bus = {
        "master": {"node_id": 1, "sync_period": 10000},
        "defaults": {
            "dcf": "drive.eds",
            "scale_pos_from_dev": 1e-5,
            "tpdo": {
                1: {"enabled": True, "mapping": [{"index": 0x6041, "sub_index": 0}]},
                2: {
                    "enabled": True,
                    "mapping": [
                        {"index": 0x6077, "sub_index": 0}, {"index": 0x6064, "sub_index": 0}
                    ],
                },
            },
        },
        "nodes": {f"axis{k}": {"node_id": 10 - k} for k in (1, 2, 3)},
    }  # fmt: skip
    (folder / "bus.yml").write_text(yaml.safe_dump(mapping_of_bus))
    assert made(folder, "--eds", str(folder / "bus.yml")) == 0
    config = load(folder / "robot.yaml")
    assert config.buses[0].rate_hz == 100.0
    messages = {own.name: own for own in config.buses[0].messages}
    for joint, node in zip(config.joints, (9, 8, 7), strict=True):
        position = joint.signals["position"]
        message = messages[position.message]
        assert message.id == 0x280 + node
        own = {signal.name: signal for signal in message.signals}[position.signal]
        assert (own.start, own.bits, own.number, own.scale, own.unit) == (
            16, 32, "signed", 1e-5, "rad",
        )  # fmt: skip
    assert main(["check", str(folder / "robot.yaml")]) == 0, capsys.readouterr().err


def test_a_feed_needs_no_description(folder, capsys):
    assert made(folder, "--feed", "--rate-hz", "500") == 0
    config = load(folder / "robot.yaml")
    assert (config.buses[0].interface, config.buses[0].rate_hz) == ("samples", 500.0)
    assert config.buses[0].feed is not None
    assert {joint.driver for joint in config.joints} == {"samples"}
    assert main(["check", str(folder / "robot.yaml")]) == 0, capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--bus", "robot.dbc"], "--bus: 'robot.dbc' must be NAME=FILE"),
        (["--bus", "a b={}/robot.dbc"], "buses.0.name"),
        (["--bus", "arm={}/nothing.dbc"], "--bus: {}/nothing.dbc: is not a file"),
        (["--bus", "arm={}/few.dbc"], "positions of axis1, axis2, axis3"),
        (["--bus", "arm={}/few.dbc"], "Status.Angle: 2 for 3 joints"),
        (["--bus", "arm={}/few.dbc"], "it has: Drive1_Command.Position_Target, "),
        (["--bus", "arm={}/named.dbc"], "Status.Angle: none of axis2"),
        (["--eds", "{}/robot.dbc"], "--eds: {}/robot.dbc: ends in '.dbc'"),
        (["--eds", "{}/bus.yml"], "--eds: {}/bus.yml: nodes: missing"),
    ],
)  # fmt: skip
def test_what_cannot_be_proposed_is_one_line(folder, capsys, words, said):
    (folder / "robot.dbc").write_text(HEAD + "".join(map(one_message, (1, 2, 3))))
    (folder / "few.dbc").write_text(HEAD + "".join(map(one_message, (1, 2))))
    named = "".join(map(one_message, (1, 3))).replace("Drive1", "Axis1").replace("Drive3", "Axis3")
    (folder / "named.dbc").write_text(HEAD + named)
    (folder / "bus.yml").write_text("master: {node_id: 1}\n")
    assert made(folder, *(word.format(folder) for word in words)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said.format(folder) in line
    assert not (folder / "robot.yaml").exists()


def test_a_log_without_a_description_lists_what_moves(folder, capsys):
    log = candump(folder / "candump.log", [1, 2, 3], in_one)
    assert made(folder, "--recording", str(log)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "0x203 100 Hz 8 bytes, of which 0-5 move" in line
