"""The lines of `fsw import` on described joints: counts are those of the frames made here."""

import struct

from fsw.config import Config, JointConfig, load
from fsw.drivers.wire import CanFrame, frame_array
from offline.importing.decoded import decoded_lines
from tests.support.driver_configs import bus_config, joint_config, unit_on_bus

MS = 1_000_000
MESSAGES = [
    {
        "name": "drive",
        "id": 0x201,
        "length": 6,
        "signals": [
            {"name": "angle", "start": 0, "bits": 32, "number": "signed", "scale": 1e-6},
            {"name": "torque", "start": 32, "bits": 16, "number": "signed", "unit": "N m"},
        ],
    }
]


def test_an_import_says_what_was_decoded_and_what_is_left_out():
    bus = bus_config(rate_hz=100.0, sync="none", listen_only=True, messages=MESSAGES)
    joint = JointConfig(
        **joint_config(1).model_dump()
        | {
            "node_id": None,
            "driver": "described",
            "signals": {
                "position": {"message": "drive", "signal": "angle", "unit": "rad"},
                "torque": {"message": "drive", "signal": "torque"},
            },
            "timing": {"by": "arrival", "sigma_s": 1e-4},
        }
    )
    config = Config.model_construct(buses=(bus,), joints=(joint,))
    frames = [CanFrame(10**12 + 10 * MS * k, 0x201, struct.pack("<ih", k, 2)) for k in range(200)]
    del frames[150]
    frames[100] = CanFrame(frames[100].t_ns, 0x201, b"\0\0\0")
    frames += [CanFrame(frames[-1].t_ns + MS * k, 0x701, b"\5") for k in range(1, 4)]
    lines = decoded_lines(config, bus, frame_array(frames))
    assert len(lines) == 2
    assert "position drive.angle (0x201) 32 bits signed, step 1e-06" in lines[0]
    assert lines[0].endswith(": 198 samples; left out: 2 lost, 1 length"), lines[0]
    assert lines[1] == "  not described: 3 frames of 0x701 (3)"


def test_frames_of_tailored_nodes_beside_a_described_unit_are_known(arm):
    unit_on_bus(arm.data)
    config = load(arm.write())
    frames = [CanFrame(10**12 + MS, word, bytes(8)) for word in (0x80, 0x191, 0x711, 0x300, 0x345)]
    lines = decoded_lines(config, config.buses[0], frame_array(frames))
    assert len(lines) == 2
    assert lines[1] == "  not described: 1 frames of 0x345 (1)"
