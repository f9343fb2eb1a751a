"""Frames of the tailored nodes: vectors of the ICD; the DBC and EDS files shipped say the same."""

import math
import struct
from collections.abc import Mapping
from pathlib import Path

import canopen as canopen_library
import cantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw import drivers
from fsw.drivers.codecs import canopen
from fsw.drivers.layout import shipped
from fsw.drivers.layout.decoder import Decoder
from fsw.drivers.layout.signals import Message, faults
from fsw.drivers.sources import thrusters, wheels
from fsw.drivers.wire import Reject
from tests.support.encoders import tpdo1, tpdo1_fd

FOLDER = Path(drivers.__file__).parent
JOINT, WHEEL, THRUSTER = (
    cantools.database.load_file(FOLDER / f"ecss_{name}.dbc")
    for name in ("joint", "wheel", "thruster")
)
frames = st.binary(min_size=8, max_size=8)


def read(message: Message, *data: bytes) -> Mapping[str, np.ndarray]:
    names = [signal.name for signal in message.signals]
    octets = np.array([list(one) for one in data], np.uint8)
    return dict(zip(names, Decoder(message, message.signals)(octets), strict=True))


def test_descriptions_have_no_fault() -> None:
    for message in (shipped.JOINT, shipped.JOINT_FD, shipped.JOINT_SLOW, wheels.REPORT,
                    wheels.SLOW, thrusters.REPORT):  # fmt: skip
        assert not list(faults(message))
    lengths = [shipped.JOINT.length, shipped.JOINT_FD.length, wheels.SLOW.length]
    assert lengths == [8, 20, 2]


def test_vectors_of_the_icd() -> None:
    golden = bytes.fromhex("0712cdff2efb092a")  # q = -1.25 rad, -12.34 N m, 0x09, SYNC 42
    joint = read(shipped.JOINT, golden)
    assert abs(joint["position"][0] + 1.25) < math.tau * 2**-25
    assert joint["torque"] == pytest.approx([-12.34])
    assert (joint["status"].tolist(), joint["counter"].tolist()) == ([0x09], [42])
    assert tpdo1(-1.25, -12.34, 0x09, 42) == golden
    wheel = read(wheels.REPORT, bytes.fromhex("8119bf2fd204092a"))
    assert wheel["speed"] == pytest.approx([300.0], abs=4e-7)
    assert wheel["torque"] == pytest.approx([0.1234])
    assert (wheel["status"].tolist(), wheel["counter"].tolist()) == ([9], [42])
    valves = read(thrusters.REPORT, bytes.fromhex("0500d2040700082a"))
    found = [valves[name].tolist() for name in ("valves", "age", "changes", "status", "counter")]
    assert found == [[5], pytest.approx([0.01234]), [7], [8], [42]]


raw_frames = st.lists(
    st.tuples(
        st.integers(-(2**31), 2**31 - 1),
        st.integers(-(2**15), 2**15 - 1),
        st.binary(min_size=2, max_size=2),
    ),
    min_size=1,
    max_size=5,
)


@given(raw_frames)
def test_a_joint_frame_encodes_back_to_its_bytes(raw: list[tuple[int, int, bytes]]) -> None:
    sent = [struct.pack("<ih", position, torque) + tail for position, torque, tail in raw]
    columns = read(shipped.JOINT, *sent).values()
    assert [tpdo1(*row) for row in zip(*(c.tolist() for c in columns), strict=True)] == sent


def test_the_fd_tailoring_decodes_every_field() -> None:
    found = read(shipped.JOINT_FD, tpdo1_fd(0.5, -3.25, 0x0109, 240), tpdo1_fd(-0.5, 3.5, 0x09, 1))
    assert np.abs(found["position"] - [0.5, -0.5]).max() < 4e-7
    assert found["torque"] == pytest.approx([-3.25, 3.5], abs=1e-9)
    assert found["velocity"] == pytest.approx([1234 * math.tau / 2**24] * 2)
    assert (found["status"].tolist(), found["counter"].tolist()) == ([0x0109, 9], [240, 1])
    assert (found["temperature"].tolist(), found["device_time"].tolist()) == ([-7] * 2, [99] * 2)


def test_the_first_bytes_of_wider_rows_decode_alike() -> None:
    wide = np.zeros((3, 64), np.uint8)
    wide[:, :8] = list(bytes.fromhex("0712cdff2efb092a"))
    position, _, _, counter = shipped.READ_JOINT(wide)
    assert counter.tolist() == [42] * 3
    assert np.abs(position + 1.25).max() < math.tau * 2**-25


@given(frames)
def test_the_dbc_files_read_frames_alike(data: bytes) -> None:
    joint, oracle = read(shipped.JOINT, data), JOINT.decode_message("TPDO1", data)
    assert joint["position"] == pytest.approx([oracle["position"]], rel=1e-12)
    assert joint["torque"] == pytest.approx([oracle["link_torque"]], rel=1e-12)
    assert joint["counter"].tolist() == [oracle["sync_counter"]]
    names = ("torque_valid", "torque_overload", "torque_fault", "encoder_valid",
             "encoder_fault", "brake_engaged", "sync_lost", "test_data")  # fmt: skip
    assert joint["status"].tolist() == [sum(oracle[name] << k for k, name in enumerate(names))]
    wheel, oracle = read(wheels.REPORT, data), WHEEL.decode_message("TPDO1", data)
    assert wheel["speed"] == pytest.approx([oracle["speed"]], rel=1e-12)
    assert wheel["torque"] == pytest.approx([oracle["motor_torque"]], rel=1e-12)
    assert wheel["counter"].tolist() == [oracle["sync_counter"]]
    names = ("torque_valid", "torque_overload", "torque_fault", "speed_valid", "speed_fault", "",
             "sync_lost", "test_data")  # fmt: skip
    bits = sum(oracle[name] << bit for bit, name in enumerate(names) if name)
    assert (int(wheel["status"][0]) & ~0x20) == bits
    valves, oracle = read(thrusters.REPORT, data), THRUSTER.decode_message("TPDO1", data)
    assert valves["valves"].tolist() == [oracle["valves"]]
    assert valves["changes"].tolist() == [oracle["changes"]]
    assert valves["counter"].tolist() == [oracle["sync_counter"]]
    assert valves["age"][0] == pytest.approx(oracle["age"])
    places = {"valves_valid": 3, "driver_fault": 4, "sync_lost": 6, "test_data": 7}
    assert (int(valves["status"][0]) & 0xD8) == sum(oracle[n] << bit for n, bit in places.items())


@given(frames)
def test_the_dbc_files_read_slow_services_alike(data: bytes) -> None:
    slow, oracle = read(shipped.JOINT_SLOW, data), JOINT.decode_message("TPDO2", data)
    assert slow["velocity"] == pytest.approx([oracle["velocity"]], rel=1e-12)
    assert slow["motor_torque"] == pytest.approx([oracle["motor_torque"]], rel=1e-12)
    assert slow["temperature"] == pytest.approx([oracle["temperature"]], rel=1e-12)
    warm = WHEEL.decode_message("TPDO2", data[:2])["temperature"]
    assert read(wheels.SLOW, data[:2])["temperature"] == pytest.approx([warm], rel=1e-12)
    emergency, oracle = canopen.decode_emcy(data), JOINT.decode_message("EMCY", data)
    assert not isinstance(emergency, Reject)
    assert (emergency.code, emergency.register) == (oracle["code"], oracle["register"])
    state = JOINT.decode_message("HEARTBEAT", data[:1])["state"]
    assert canopen.decode_heartbeat(data[:1]) == state


@settings(max_examples=20)
@given(frames)
@pytest.mark.parametrize(
    ("name", "node", "number", "cob_id", "message"),
    [
        ("joint", 0x11, 1, 0x191, shipped.JOINT),
        ("joint", 0x11, 2, 0x291, shipped.JOINT_SLOW),
        ("wheel", 0x21, 1, 0x1A1, wheels.REPORT),
        ("wheel", 0x21, 2, 0x2A1, wheels.SLOW),
        ("thruster", 0x31, 1, 0x1B1, thrusters.REPORT),
    ],
)
def test_the_eds_files_map_the_pdos_alike(
    name: str, node: int, number: int, cob_id: int, message: Message, data: bytes
) -> None:
    library = canopen_library.Network().add_node(node, str(FOLDER / f"ecss_{name}.eds"))
    pdo = library.tpdo[number]
    pdo.read(from_od=True)
    assert pdo.cob_id == cob_id
    pdo.data = bytearray(data[: message.length])
    scales = np.array([signal.scale for signal in message.signals])
    own = np.array([column[0] for column in read(message, data[: message.length]).values()])
    assert np.array([variable.raw for variable in pdo]) * scales == pytest.approx(own)
