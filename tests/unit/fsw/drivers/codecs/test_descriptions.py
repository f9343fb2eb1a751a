"""The DBC and EDS shipped with the joint node agree with the codec."""

from pathlib import Path

import canopen as canopen_library
import cantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw import drivers
from fsw.drivers.codecs import canopen
from fsw.drivers.wire import Reject

FOLDER = Path(drivers.__file__).parent
DATABASE = cantools.database.load_file(FOLDER / "ecss_joint.dbc")
frames = st.binary(min_size=8, max_size=8)


@given(frames)
def test_dbc_reads_tpdo1_as_the_codec_does(data: bytes) -> None:
    pdo = canopen.decode_tpdo1(np.frombuffer(data, np.uint8)[None])
    oracle = DATABASE.decode_message("TPDO1", data)
    assert pdo.position_rad == pytest.approx([oracle["position"]], rel=1e-12)
    assert pdo.torque_nm == pytest.approx([oracle["link_torque"]], rel=1e-12)
    assert pdo.sync_counter.tolist() == [oracle["sync_counter"]]
    names = ("torque_valid", "torque_overload", "torque_fault", "encoder_valid",
             "encoder_fault", "brake_engaged", "sync_lost", "test_data")  # fmt: skip
    assert pdo.status.tolist() == [sum(oracle[name] << bit for bit, name in enumerate(names))]


@given(frames)
def test_dbc_reads_slow_services_as_the_codec_does(data: bytes) -> None:
    slow, oracle = canopen.decode_tpdo2(data), DATABASE.decode_message("TPDO2", data)
    assert not isinstance(slow, Reject)
    assert slow.velocity_rad_s == pytest.approx(oracle["velocity"], rel=1e-12)
    assert slow.motor_torque_ratio == pytest.approx(oracle["motor_torque"], rel=1e-12)
    assert slow.temperature_c == pytest.approx(oracle["temperature"], rel=1e-12)
    emergency, oracle = canopen.decode_emcy(data), DATABASE.decode_message("EMCY", data)
    assert not isinstance(emergency, Reject)
    assert (emergency.code, emergency.register) == (oracle["code"], oracle["register"])
    assert (
        canopen.decode_heartbeat(data[:1])
        == DATABASE.decode_message("HEARTBEAT", data[:1])["state"]
    )


@settings(max_examples=50)
@given(frames)
def test_eds_maps_the_pdos_as_the_codec_reads_them(data: bytes) -> None:
    node = canopen_library.Network().add_node(0x11, str(FOLDER / "ecss_joint.eds"))
    for number, cob_id in ((1, 0x191), (2, 0x291)):
        pdo = node.tpdo[number]
        pdo.read(from_od=True)
        assert pdo.cob_id == cob_id
        pdo.data = bytearray(data)
        values = [variable.raw for variable in pdo]
        if number == 1:
            decoded = canopen.decode_tpdo1(np.frombuffer(data, np.uint8)[None])
            position, torque, status, counter = values
            assert decoded.position_rad == pytest.approx([position * canopen.POSITION_SCALE_RAD])
            assert decoded.torque_nm == pytest.approx([torque * 0.01])
            found = decoded.status.tolist(), decoded.sync_counter.tolist()
            assert found == ([status], [counter])
        else:
            slow = canopen.decode_tpdo2(data)
            assert not isinstance(slow, Reject)
            assert slow.temperature_c == pytest.approx(values[2] * 0.1)
