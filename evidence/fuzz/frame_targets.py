"""Targets for the CAN bus: PDO codecs, error frames, the bus source, and recorded frames."""

import struct

import numpy as np

from evidence.fuzz.oracle import Target, require, segments
from fsw.config import BusConfig, JointConfig
from fsw.drivers.codecs import canopen
from fsw.drivers.codecs.can_error import decode_error
from fsw.drivers.layout.decoder import Decoder
from fsw.drivers.layout.shipped import JOINT_FD, READ_JOINT, READ_JOINT_SLOW
from fsw.drivers.sources import JointBusSource
from fsw.drivers.wire import CanFrame, Reject, frame_array, pack_frame, unpack_frame

MS = 1_000_000
TURN = 2 * np.pi / 2**24
PDOS = (  # how flight software reads a PDO, and how its bytes are packed again: form and scales
    (READ_JOINT, struct.Struct("<ihBB"), (TURN, 1e-2, 1, 1)),
    (READ_JOINT_SLOW, struct.Struct("<ihh"), (TURN, 1e-3, 0.1)),
    (
        Decoder(JOINT_FD, JOINT_FD.signals),
        struct.Struct("<iiiHBbI"),
        (TURN, TURN, 1e-4, 1, 1, 1, 1),
    ),
)
FLAGS = ("is_error", "is_remote", "is_extended", "is_fd")


def canopen_target() -> Target:
    """Return the target of a bus with one joint in classic format and one in FD format."""
    bus = BusConfig.model_validate(
        {"name": "arm", "interface": "virtual", "channel": "c", "rate_hz": 250.0, "fd": True}
    )
    joint = {
        "bus": "arm",
        "torque_limit_nm": 200.0,
        "speed_limit_rad_s": 2.0,
        "torque_noise_nm": 0.05,
        "torque_offset_sigma_nm": 0.1,
        "position_noise_rad": 1e-5,
    }
    joints = [
        (0, JointConfig.model_validate({**joint, "name": "a", "node_id": 0x11})),
        (1, JointConfig.model_validate({**joint, "name": "b", "node_id": 0x12, "format": "fd"})),
    ]

    def one(data: bytes) -> None:
        source = JointBusSource(bus, joints)
        count = size = accepted = 0
        frames: list[CanFrame] = []
        t_ns = 10 * MS
        for op, payload in segments(data):
            if len(payload) < 2:
                continue
            t_ns += (op >> 4) * MS
            frame = _frame(op, payload, t_ns)
            count, size = count + 1, size + len(frame.data)
            check_codecs(frame)
            frames.append(frame)
            samples = source.feed(frame_array([frame]))
            accepted += len(samples)
            require(bool(np.isfinite(samples.position_rad).all()), "position", samples)
            require(not np.isinf(samples.torque_nm).any(), "torque", samples)
        c = source.counters
        done = c["accepted"] + c["rejected"] + c["other_frames"] + c["error_frames"]
        syncs = c["sync"] + c["sync_invalid"] + c["sync_echoes"]
        require(done + syncs == count, "frames are not conserved", count, c)
        require(c["accepted_bytes"] + c["rejected_bytes"] == c["received_bytes"], "bytes", c)
        require(c["received_bytes"] <= size, "more bytes than came", c)
        require(c["accepted"] == accepted, "samples are not conserved", accepted, c)
        require(len(source.events()) <= 256, "events grow")
        together = JointBusSource(bus, joints)
        samples = together.feed(frame_array(frames))
        require(len(samples) == accepted, "samples depend on the batch", accepted, samples)
        require(together.counters == c, "counters depend on the batch", together.counters, c)

    return one


def _frame(op: int, payload: bytes, t_ns: int) -> CanFrame:
    """Return a frame; one in four identifiers is arbitrary, the others belong to the two joints."""
    common = (0x080, 0x191, 0x192, 0x291, 0x091, 0x711, 0x111 + 0x80, 0x712)
    any_id = int.from_bytes(payload[:2], "big") & 0x7FF
    can_id = any_id if op & 0x03 == 0 else common[payload[0] & 7]
    data = payload[2:66] if op & 0x04 else payload[2:10]
    strange = payload[1] & 0x1F == 0x1F
    return CanFrame(
        t_ns,
        can_id,
        data,
        is_fd=len(data) > 8,
        is_extended=strange and bool(payload[1] & 0x20),
        is_remote=strange and bool(payload[1] & 0x40),
        is_error=strange and bool(payload[1] & 0x80),
    )


def check_codecs(frame: CanFrame) -> None:
    """Decode the data of a frame as every service; require that encoding gives the same data."""
    data = frame.data
    octets = np.frombuffer(data, np.uint8)[None]
    for read, form, scales in PDOS:
        if len(data) == form.size:
            values = [column[0] for column in read(octets)]
            again = [round(own / scale) for own, scale in zip(values, scales, strict=True)]
            require(form.pack(*again) == data, form.format, data, values)
    emergency = canopen.decode_emcy(data)
    if not isinstance(emergency, Reject):
        head = struct.pack("<HB", emergency.code, emergency.register)
        require(head + emergency.detail == data, "EMCY", data, emergency)
    require(isinstance(emergency, Reject) == (len(data) != 8), "accepted by length", data)
    counter = canopen.decode_sync(data, 240)
    if not isinstance(counter, Reject):
        require(canopen.encode_sync(counter)[1] == data, "SYNC", data, counter)
    report = decode_error(frame.can_id, data)
    require(isinstance(report, Reject) or len(report.conditions) <= 16, "error frame", report)


def recorded_frame_target() -> Target:
    """Return the target of recorded frames, which have the layout of Linux `can_frame`."""

    def one(data: bytes) -> None:
        size = 72 if data[:1] >= b"\x80" else 16
        raw = data[1:] if len(data) % 3 == 0 else data[1 : 1 + size].ljust(size, b"\0")
        frame = unpack_frame(7, raw)
        if frame is None:
            long = len(raw) in (16, 72) and raw[4] > len(raw) - 8
            require(long or len(raw) not in (16, 72), "refused", raw)
            return
        require(unpack_frame(7, pack_frame(frame)) == frame, "frame", raw, frame)
        require(len(pack_frame(frame)) == len(raw), "length", raw, frame)

    return one
