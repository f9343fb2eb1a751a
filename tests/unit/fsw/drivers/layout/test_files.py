"""Descriptions in files: read as the libraries read them; whatever else a file is, is one line."""

import math
import subprocess
import sys
import time
from pathlib import Path

import canopen as canopen_library
import cantools
import numpy as np
import pytest

from fsw import drivers
from fsw.drivers.layout import files
from fsw.drivers.layout.decoder import Decoder
from fsw.drivers.layout.files import read_messages, read_node
from fsw.drivers.layout.signals import faults
from fsw.errors import ConfigError

FOLDER = Path(drivers.__file__).parent
HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: A\n'
ROBOT = (
    HEAD
    + """
BO_ 2147484417 Reply: 8 A
 SG_ kind M : 0|4@1+ (1,0) [0|0] "" A
 SG_ angle m0 : 15|16@0+ (0.000381475,-12.5) [0|0] "rad" A
 SG_ torque m1 : 31|12@0- (0.01,0) [0|0] "N\xb7m" A
 SG_ current m1 : 40|24@1- (0.5,3) [0|0] "A" A

BO_ 9 Encoder: 8 A
 SG_ turns : 0|32@1- (1,0) [0|0] "rev" A
 SG_ speed : 32|32@1- (1,0) [0|0] "rev/s" A
 SIG_VALTYPE_ 9 turns : 1;
"""
)
ROBOT = ROBOT.replace(" SIG_VALTYPE_", "\nSIG_VALTYPE_")


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8"])
def test_a_dbc_is_read_as_by_its_library(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "robot.dbc"
    path.write_bytes(ROBOT.encode(encoding))
    messages = read_messages(path)
    assert {name: own.identifier for name, own in messages.items()} == {"Reply": 769, "Encoder": 9}
    assert messages["Reply"].is_extended
    assert messages["Reply"].signals[2].unit == "N\xb7m"
    library = cantools.database.load_file(path, encoding=encoding)
    data = np.random.default_rng(1).integers(0, 256, (300, 8), np.uint8)
    data[:, 0] %= 3
    seen = 0
    for name, message in messages.items():
        assert not list(faults(message))
        columns = Decoder(message, message.signals)(data)
        for row, octets in enumerate(data):
            known = name == "Encoder" or octets[0] % 16 < 2
            expected = library.decode_message(name, octets.tobytes()) if known else {}
            for signal, column in zip(message.signals, columns, strict=True):
                if signal.name in expected:
                    seen += 1
                    assert column[row] == expected[signal.name] or math.isnan(column[row])
                elif expected:
                    assert math.isnan(column[row])
    assert seen > 1000


EDS = """[DeviceInfo]
[1800]
ParameterName=TPDO1
ObjectType=0x9
SubNumber=3
[1800sub0]
ParameterName=n
DataType=0x0005
DefaultValue=2
[1800sub1]
ParameterName=COB-ID
DataType=0x0007
DefaultValue=$NODEID+0x380
[1800sub2]
ParameterName=type
DataType=0x0005
DefaultValue=1
[1A00]
ParameterName=mapping
ObjectType=0x9
SubNumber=6
[1A00sub0]
ParameterName=n
DataType=0x0005
DefaultValue=5
""" + "".join(
    f"[1A00sub{k}]\nParameterName=e{k}\nDataType=0x0007\nDefaultValue=0x{entry:08X}\n"
    for k, entry in enumerate((0x20010010, 0x00050008, 0x20020004, 0x20030004, 0x60640020), 1)
) + "".join(
    f"[{index:X}]\nParameterName=v{index:X}\nObjectType=0x7\nDataType={kind}\nPDOMapping=1\n"
    for index, kind in ((0x2001, "0x0003"), (0x2002, "0x0005"), (0x2003, "0x0002"),
                        (0x6064, "0x0004"))
)  # fmt: skip
EDS = EDS.replace("\nDefaultValue", "\nAccessType=rw\nDefaultValue")
EDS = EDS.replace("\nPDOMapping", "\nAccessType=ro\nPDOMapping")


def test_an_eds_with_gaps_and_fields_of_four_bits(tmp_path: Path) -> None:
    path = tmp_path / "node.eds"
    path.write_text(EDS)
    (message,) = read_node(path, 5).values()
    assert (message.name, message.identifier, message.length) == ("TPDO1", 0x385, 8)
    names = ["0x2001", "0x2002", "0x2003", "0x6064"]
    assert [signal.name for signal in message.signals] == names
    data = bytes.fromhex("fdff99ef04030201")  # -3, a gap, 15, -2, 0x01020304
    found = [int(column[0]) for column in Decoder(message, message.signals)(
        np.frombuffer(data, np.uint8)[None])]  # fmt: skip
    assert found == [-3, 15, -2, 0x01020304]


def test_the_pdos_of_an_eds_are_read_as_by_its_library() -> None:
    path = FOLDER / "ecss_joint.eds"
    node = canopen_library.Network().add_node(0x11, str(path))
    data = np.random.default_rng(2).integers(0, 256, (100, 8), np.uint8)
    for name, message in read_node(path, 0x11).items():
        pdo = node.tpdo[int(name.removeprefix("TPDO"))]
        pdo.read(from_od=True)
        assert pdo.cob_id == message.identifier
        columns = Decoder(message, message.signals)(data)
        for row, octets in enumerate(data):
            pdo.data = bytearray(octets.tobytes())
            assert [variable.raw for variable in pdo] == [int(column[row]) for column in columns]


def big(count: int) -> bytes:
    return (HEAD + "".join(f"BO_ {k} M{k}: 8 A\n\n" for k in range(count))).encode()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("robot.txt", b"", "ends in '.txt'; must end in .dbc, .kcd, .sym, .arxml"),
        ("robot.dbc", None, "is not a file"),
        ("robot.dbc", b"\x7fELF\0\0" * 100, "is binary, not a description in text"),
        ("robot.dbc", b"\xff\xfe\x81" * 100, "cannot be read: "),
        ("robot.dbc", b"BO_ 1 A: 8", "cannot be read: "),
        ("robot.dbc", HEAD.encode(), "describes no message"),
        ("robot.dbc", big(100_000), "has 100000 messages or entries; at most 5000"),
        ("robot.dbc", b" " * 4_000_001, "is larger than 4000000 bytes"),
        ("robot.kcd", b"<a>" * 100_000, "cannot be read: "),
        ("robot.arxml", b"<AUTOSAR/>", "cannot be read: "),
        ("node.eds", b"[1A00]\n" * 1_000_000, "is larger than"),
        ("node.eds", b"[1A00]\n" * 10_000, "has 10000 messages or entries"),
        ("node.eds", EDS.replace("[6064]", "[6065]").encode(), "cannot be read: object 0x6064:00"),
        ("node.eds", b"no section", "cannot be read: "),
    ],
)
def test_a_hostile_file_is_one_line(
    tmp_path: Path, name: str, content: bytes | None, words: str
) -> None:
    path = tmp_path / name
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    began_s = time.monotonic()
    with pytest.raises(ConfigError) as caught:
        read_node(path, 1) if name.endswith("eds") else read_messages(path)
    (line,) = str(caught.value).splitlines()
    assert line.startswith(f"{path}: {words}")
    assert len(line) < len(str(path)) + 400
    assert time.monotonic() - began_s < 5.0


def test_a_library_writes_no_lines_of_its_own(tmp_path: Path) -> None:
    """A file without its mandatory section is read; the library's complaint is no output."""
    path = tmp_path / "node.eds"
    path.write_text(EDS.removeprefix("[DeviceInfo]\n"))
    words = "import sys, pathlib; from fsw.drivers.layout.files import read_node; "
    words += "print(sorted(read_node(pathlib.Path(sys.argv[1]), 1)))"
    done = subprocess.run(
        [sys.executable, "-c", words, str(path)], capture_output=True, text=True, check=False
    )
    assert (done.stdout.strip(), done.stderr) == ("['TPDO1']", "")


def test_as_many_messages_as_allowed_are_read_in_bounded_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "MOST_MESSAGES", 500)
    path = tmp_path / "robot.dbc"
    path.write_bytes(big(500))
    assert len(read_messages(path)) == 500
    path.write_bytes(big(501))
    with pytest.raises(ConfigError, match="has 501 messages"):
        read_messages(path)
