"""Wheel nodes: the ICD's vector, and the DBC and EDS shipped agree with the codec."""

from pathlib import Path

import canopen as canopen_library
import cantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw import drivers
from fsw.drivers.codecs import wheel
from fsw.drivers.wire import Reject

FOLDER = Path(drivers.__file__).parent
DATABASE = cantools.database.load_file(FOLDER / "ecss_wheel.dbc")
NAMES = ("torque_valid", "torque_overload", "torque_fault", "speed_valid", "speed_fault", "",
         "sync_lost", "test_data")  # fmt: skip
frames = st.binary(min_size=8, max_size=8)


def decoded(data: bytes) -> wheel.WheelTpdo1:
    return wheel.decode_tpdo1(np.frombuffer(data, np.uint8)[None])


def test_vector_of_the_icd() -> None:
    pdo = decoded(bytes.fromhex("8119bf2fd204092a"))
    assert pdo.speed_rad_s == pytest.approx([300.0], abs=4e-7)
    assert pdo.torque_nm == pytest.approx([0.1234])
    assert (pdo.status.tolist(), pdo.sync_counter.tolist()) == ([9], [42])


@given(frames)
def test_dbc_reads_the_pdos_as_the_codec_does(data: bytes) -> None:
    pdo, oracle = decoded(data), DATABASE.decode_message("TPDO1", data)
    assert pdo.speed_rad_s == pytest.approx([oracle["speed"]], rel=1e-12)
    assert pdo.torque_nm == pytest.approx([oracle["motor_torque"]], rel=1e-12)
    assert pdo.sync_counter.tolist() == [oracle["sync_counter"]]
    bits = sum(oracle[name] << bit for bit, name in enumerate(NAMES) if name)
    assert (int(pdo.status[0]) & ~0x20) == bits
    temperature = DATABASE.decode_message("TPDO2", data[:2])["temperature"]
    assert wheel.decode_tpdo2(data[:2]) == pytest.approx(temperature, rel=1e-12)


@settings(max_examples=50)
@given(frames)
def test_eds_maps_the_pdos_as_the_codec_reads_them(data: bytes) -> None:
    node = canopen_library.Network().add_node(0x21, str(FOLDER / "ecss_wheel.eds"))
    for number, cob_id, size in ((1, 0x1A1, 8), (2, 0x2A1, 2)):
        pdo = node.tpdo[number]
        pdo.read(from_od=True)
        assert pdo.cob_id == cob_id
        pdo.data = bytearray(data[:size])
        values = [variable.raw for variable in pdo]
        if number == 1:
            own = decoded(data)
            speed, torque, status, counter = values
            assert own.speed_rad_s == pytest.approx([speed * wheel.SPEED_SCALE_RAD_S])
            assert own.torque_nm == pytest.approx([torque * 1e-4])
            assert (own.status.tolist(), own.sync_counter.tolist()) == ([status], [counter])
        else:
            assert wheel.decode_tpdo2(data[:size]) == pytest.approx(values[0] * 0.1)


def test_a_temperature_of_another_length_is_rejected() -> None:
    assert wheel.decode_tpdo2(b"\0") is Reject.LENGTH
