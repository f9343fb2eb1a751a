import math
import struct

import canopen
import numpy as np
import pytest

from hil.devices.canopen import (
    COUNTS_PER_RAD,
    FieldScale,
    JointNode,
    NodeState,
    encode_emergency,
    encode_fd,
    encode_tpdo1,
    encode_tpdo2,
)
from tests.support.plant_cases import reading

MEASURED = (-1.25, 0.5, -12.34, -0.3085)
READING = reading(*MEASURED)


def test_tpdo1_is_the_vector_of_the_icd():
    assert encode_tpdo1(READING, 0x09, 42).hex() == "0712cdff2efb092a"


def test_fd_layout_is_twenty_bytes_of_the_icd():
    data = encode_fd(reading(*MEASURED, is_fd=True), 0x0109, 42, 2**32 + 7)
    position, velocity, torque, status, sync, temperature, time_us = struct.unpack("<iiiHBbI", data)
    assert len(data) == 20
    assert position == round(-1.25 / (2 * math.pi) * 2**24)
    assert velocity == round(0.5 / (2 * math.pi) * 2**24)
    assert (torque, status, sync, temperature, time_us) == (-123400, 0x0109, 42, 25, 7)


def test_tpdo2_carries_velocity_motor_torque_and_temperature():
    velocity, torque, temperature = struct.unpack("<ihh", encode_tpdo2(READING))
    assert velocity == round(0.5 / (2 * math.pi) * 2**24)
    assert (torque, temperature) == (-308, 250)


def test_values_beyond_a_field_saturate():
    extreme = (1e6, -1e6, -1e6, 1e6)
    classic, fd = reading(*extreme), reading(*extreme, is_fd=True)
    assert classic == (2**31 - 1, -(2**31), -(2**15), 2**15 - 1, True)
    assert fd == (2**31 - 1, -(2**31), -(2**31), 2**15 - 1, True)
    assert struct.unpack_from("<ih", encode_tpdo1(classic, 0, 1)) == (2**31 - 1, -(2**15))


def test_half_a_count_rounds_to_even_and_nodes_keep_their_own_torque_unit():
    measured = np.zeros((4, 3))
    measured[0] = np.array([0.5, 1.5, -2.5]) / COUNTS_PER_RAD
    measured[2] = 12.0
    (readings,) = FieldScale([False, True, False], 327.0).readings(measured[:, None])
    assert [r.position for r in readings] == [0, 2, -2]
    assert [r.torque for r in readings] == [1200, 120_000, 1200]


def test_a_node_reports_an_overload_beyond_its_range():
    def status(torque_nm):
        (tpdo1,) = JointNode(node_id=0x11, joint=1).on_sync(2, reading(0.0, 0.0, torque_nm), 0)
        return tpdo1[6]

    assert status(-327.0) == 0x09
    assert status(-327.1) == 0x0B


def test_emergency_is_understood_by_the_canopen_library():
    consumer = canopen.emcy.EmcyConsumer()
    consumer.on_emcy(0x91, encode_emergency(0x4210, 0x09, b"\x01\x02"), 0.0)
    error = consumer.active[0]
    assert (error.code, error.register, error.data) == (0x4210, 0x09, b"\x01\x02\0\0\0")


def test_node_boots_into_pre_operational_and_waits_for_nmt_start_without_autostart():
    node = JointNode(node_id=0x11, joint=1, autostart=False)
    assert node.on_sync(1, READING, 0) == ()
    node.on_nmt(0x01, 0)
    assert node.state is NodeState.OPERATIONAL
    assert node.on_sync(2, READING, 0) == (encode_tpdo1(READING, 0x09, 2),)


def test_autostart_yields_to_an_explicit_command():
    node = JointNode(node_id=0x11, joint=1)
    node.on_nmt(0x80, 0x11)
    assert node.on_sync(1, READING, 0) == ()
    assert JointNode(node_id=0x11, joint=1).on_sync(1, READING, 0) != ()


@pytest.mark.parametrize(("command", "state"), [(0x02, 0x04), (0x80, 0x7F), (0x01, 0x05)])
def test_nmt_commands_reach_the_state_they_name(command, state):
    node = JointNode(node_id=0x11, joint=1)
    assert not node.on_nmt(command, 0x11)
    assert node.state == state


def test_nmt_for_another_node_changes_nothing_and_reset_restarts():
    node = JointNode(node_id=0x11, joint=1)
    node.on_nmt(0x01, 0x12)
    assert node.state is NodeState.PRE_OPERATIONAL
    assert node.on_nmt(0x81, 0)


def test_tpdo2_comes_every_tenth_sync_staggered_by_joint():
    for joint in (1, 4, 7):
        node = JointNode(node_id=0x10 + joint, joint=joint)
        sent = []
        for k in range(480):
            counter = k % 240 + 1
            if len(node.on_sync(counter, READING, 0)) == 2:
                sent.append(k + 1)
        assert sent == list(range(joint + 9, 481, 10))


@pytest.mark.parametrize(
    ("index", "subindex", "value"),
    [(0x1000, 0, 0x00020192), (0x1018, 0, 4), (0x1018, 4, 0x11), (0x1019, 0, 240)],
)
def test_sdo_upload_is_understood_by_the_canopen_library(index, subindex, value):
    node = JointNode(node_id=0x11, joint=1)
    client = canopen.sdo.SdoClient(0x611, 0x591, canopen.ObjectDictionary())

    class Network:
        def send_message(self, _can_id, data):
            client.on_response(0x591, bytearray(node.on_sdo(bytes(data))), 0.0)

    client.network = Network()
    assert int.from_bytes(client.upload(index, subindex), "little") == value
    with pytest.raises(canopen.SdoAbortedError) as caught:
        client.upload(0x6064, 0)
    assert caught.value.code == 0x06020000
    with pytest.raises(canopen.SdoAbortedError):
        client.download(0x1000, 0, b"\0\0\0\0")
