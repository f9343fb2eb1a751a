"""Targets for the serial lines: framing, codecs and sources of inertial unit and star tracker."""

import struct
from collections.abc import Callable, Mapping, Sequence, Sized
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from inspect import Parameter
from math import isfinite
from typing import Protocol, get_args

import numpy as np

from evidence.fuzz.oracle import MAX_INPUT_BYTES, Seal, Target, chunks, require
from fsw.config import ImuConfig, StarTrackerConfig
from fsw.drivers.codecs import mip, sagitta, stim300
from fsw.drivers.codecs.entries import IMU, codec_class, imu_codec, options_of
from fsw.drivers.codecs.framing import Frame, Framer
from fsw.drivers.codecs.imu_datagram import ImuDatagram
from fsw.drivers.sources import ImuSource, StarTrackerSource
from fsw.drivers.wire import ByteChunk, Reject
from hil.devices import sagitta as sagitta_device
from hil.devices import stim300 as stim_device

MS = 1_000_000
MOUNTING = {"p_BS_m": [0.0, 0.0, 0.0], "q_BS_xyzw": [0.0, 0.0, 0.0, 1.0]}
LONGEST = {"stim300": 65, "mip": 134, "sagitta": 1024}  # bytes of a frame, docs/icd.md
HEAD_BYTES = 4  # sync bytes, and length or masks
SPLIT_BYTES = 128  # a longer stream is not also fed byte by byte, which is slow
CONSERVED = ("accepted_bytes", "rejected_bytes", "skipped_bytes", "pending_bytes")
Confirm = Callable[[bytes], None]


class Source(Protocol):
    """A source of one serial device."""

    @property
    def counters(self) -> dict[str, int]:
        """Counters by name."""
        ...

    def feed(self, chunks: Sequence[ByteChunk]) -> Sized:
        """Decode chunks; return the samples."""
        ...


def imu_config(driver: str, *, crlf: bool = False) -> ImuConfig:
    """Return the configuration of an inertial unit; a required option has its first choice."""
    options = options_of(codec_class(IMU, driver))
    required = [o for o in options.values() if o.default is Parameter.empty]
    return ImuConfig.model_validate(
        {
            "driver": driver,
            "options": {
                option.name: get_args(option.annotation)[0]
                for option in required
                if option.name not in ImuConfig.model_fields
            },
            "port": "p",
            "rate_hz": 500.0,
            "crlf": crlf,
            "mounting": MOUNTING,
            "gyro_group_delay_s": 0.0022,
            "acc_group_delay_s": 0.0063,
            "angle_random_walk_rad_sqrt_s": 4e-5,
            "velocity_random_walk_m_s_sqrt_s": 1e-3,
            "gyro_bias_sigma_rad_s": 1e-5,
            "acc_bias_sigma_m_s2": 1e-2,
        }
    )


def tracker_config() -> StarTrackerConfig:
    """Return the configuration of a star tracker whose samples have the unit's own times."""
    return StarTrackerConfig.model_validate(
        {
            "port": "p",
            "rate_hz": 5.0,
            "mounting": MOUNTING,
            "time": "unit",
            "latency_s": 0.1,
            "noise_across_rad": 1e-5,
            "noise_about_rad": 5e-5,
        }
    )


def framed(framer: Framer, pieces: Sequence[bytes]) -> tuple[list[Frame], Framer]:
    """Return the frames of a stream that is fed in pieces, and the framer."""
    frames = []
    for k, piece in enumerate(pieces):
        frames += framer.feed(ByteChunk(k * MS, piece))
    return frames, framer


def check_stream(
    data: bytes,
    seal: Callable[[bytes], bytes],
    framer_of: Callable[[], Framer],
    source: Source,
    longest: int,
    confirm: Confirm,
) -> None:
    """Check that no byte is lost, buffers are bounded, pieces do not matter, and frames are right.

    Parameters
    ----------
    longest : most bytes that may wait in the framer
    confirm : encodes a frame again with an independent encoder and requires the same bytes
    """
    pieces = chunks(data, seal)
    whole = b"".join(pieces)
    frames, framer = framed(framer_of(), pieces)
    at_once, _ = framed(framer_of(), [whole])
    found = [frame.data for frame in frames]
    require(found == [f.data for f in at_once], "frames depend on the pieces", pieces)
    if len(whole) <= SPLIT_BYTES:
        bytewise, _ = framed(framer_of(), [whole[k : k + 1] for k in range(len(whole))])
        require(found == [f.data for f in bytewise], "frames depend on single bytes", pieces)
    in_frames = sum(map(len, found))
    counted = in_frames + framer.skipped_bytes + framer.pending_bytes
    require(counted == framer.received_bytes == len(whole), "framer loses bytes", counted)
    require(framer.pending_bytes <= longest, "framer's buffer grows", framer.pending_bytes)
    rest = whole
    for frame in frames:
        at = rest.find(frame.data)
        require(at >= 0, "a frame is not in the stream, in order", frame.data)
        rest = rest[at + len(frame.data) :]
        lengths = sum(piece.length for piece in frame.pieces)
        require(lengths == len(frame.data), "pieces are not the frame", frame)
        confirm(frame.data)
    for k, piece in enumerate(pieces):
        source.feed([ByteChunk(k * MS, piece)])
        check_counters(source.counters)


def check_counters(counts: Mapping[str, int]) -> None:
    """Require that every byte and every sample of a serial source is accounted for."""
    counted = sum(counts[name] for name in CONSERVED)
    require(counted == counts["received_bytes"], "source loses bytes", counts)
    rejects = sum(n for name, n in counts.items() if name.startswith("reject_"))
    require(rejects == counts["rejected"], "rejects do not add up", counts)
    require(counts["accepted"] + rejects == counts["received"], "samples do not add up", counts)
    require(min(counts.values()) >= 0, "a counter is negative", counts)


def seal_stim(payload: bytes, *, crlf: bool) -> bytes:
    """Return a datagram for the identifier in the first byte, with its length and its CRC."""
    if not payload or payload[0] not in stim300.LAYOUTS:
        return payload
    body = payload.ljust(80, b"\0")[: stim_device.layout_of(payload[0]).length - 4]
    crc = stim_device.crc32_mpeg2(body + bytes(-len(body) % 4)).to_bytes(4, "big")
    return body + crc + (b"\r\n" if crlf else b"")


def confirm_stim(frame: bytes, *, crlf: bool) -> None:
    """Decode a datagram, encode the values again, and require the same bytes."""
    datagram = stim300.decode_datagram(frame, 10)
    if isinstance(datagram, Reject):
        require(False, "an accepted datagram is not decoded", frame, datagram)
        return
    d = datagram
    acc_scale = stim_device.G_M_S2 * stim_device.ACC_LSB_G[10]
    parts = [bytes((d.identifier,)), _ints(d.gyro_rad_s, stim_device.RATE_LSB_RAD_S, 3)]
    parts.append(bytes((d.gyro_status,)))
    if d.acc_m_s2 is not None:
        parts += [_ints(d.acc_m_s2, acc_scale, 3), bytes((d.acc_status,))]
    if d.incl_m_s2 is not None:
        parts += [_ints(d.incl_m_s2, stim_device.G_M_S2 * 2.0**-22, 3), bytes((d.incl_status,))]
    celsius = (d.gyro_temperature_c, d.acc_temperature_c, d.incl_temperature_c)
    for values, status in zip(celsius, d.temperature_status, strict=True):
        if values is not None:
            parts += [_ints(values, stim_device.TEMPERATURE_LSB_DEGC, 2), bytes((status,))]
    if d.extra is not None:
        parts += [d.extra.to_bytes(3, "big", signed=True), bytes((d.extra_status,))]
    parts += [bytes((d.counter,)), d.latency_us.to_bytes(2, "big")]
    again = seal_stim(b"".join(parts), crlf=crlf)
    require(again == frame, "a datagram is not the same when encoded again", frame, again)


def _ints(values: Sequence[float], scale: float, width: int) -> bytes:
    return b"".join(round(v / scale).to_bytes(width, "big", signed=True) for v in values)


def stim_target(*, crlf: bool = False) -> Target:
    """Return the target of the STIM300."""
    config = imu_config("stim300", crlf=crlf)

    def one(data: bytes) -> None:
        check_stream(
            data,
            partial(seal_stim, crlf=crlf),
            lambda: Framer(stim300.StimMatcher(crlf)),
            ImuSource(config),
            LONGEST["stim300"],
            partial(confirm_stim, crlf=crlf),
        )

    return one


def seal_mip(payload: bytes) -> bytes:
    """Return a packet for a payload of descriptor set and fields; add length and check bytes."""
    body = (
        bytes.fromhex("7565")
        + payload[:1].ljust(1, b"\x80")
        + bytes((len(payload[1:129]),))
        + payload[1:129]
    )
    first = np.cumsum(np.frombuffer(body, np.uint8), dtype=np.int64)
    return body + bytes((int(first[-1]) & 0xFF, int(first.sum()) & 0xFF))


def confirm_mip(frame: bytes) -> None:
    """Require correct length and check bytes and, for a measurement, the values of the packet."""
    require(seal_mip(frame[2:3] + frame[4:-2]) == frame, "no packet", frame)
    datagram = mip.MipCodec().decode(Frame(frame, ()))
    if datagram is None or isinstance(datagram, Reject):
        return
    require(struct.pack(">HQ", 0x0AD5, datagram.counter) in frame, "no such time", frame)
    if datagram.w_NS_S_rad_s is not None:
        field = struct.pack(">H3f", 0x0E05, *datagram.w_NS_S_rad_s)
        require(field in frame, "no such rate", frame, datagram)


def mip_target() -> Target:
    """Return the target of the MIP units."""
    config = imu_config("mip")

    def one(data: bytes) -> None:
        source, longest = ImuSource(config), LONGEST["mip"]
        check_stream(data, seal_mip, lambda: Framer(mip.MipMatcher()), source, longest, confirm_mip)

    return one


def confirm_sagitta(frame: bytes) -> None:
    """Frame the payload of a frame again; require the same bytes, because escapes are unique."""
    payload = sagitta.decode_payload(frame)
    if isinstance(payload, Reject):
        require(False, "an accepted frame has no payload", frame, payload)
        return
    again = sagitta_device.frame(payload)
    require(again == frame, "a frame is not the same when encoded again", frame, again)
    solution = sagitta.SagittaCodec().decode(frame)
    if isinstance(solution, sagitta.Solution):
        q = struct.pack("<4f", *solution.q_wxyz)
        require(payload[16:32] == q, "no such quaternion", frame, solution)


def sagitta_target() -> Target:
    """Return the target of the star tracker."""
    config = tracker_config()

    def one(data: bytes) -> None:
        check_stream(
            data,
            sagitta_device.frame,
            lambda: Framer(sagitta.SlipMatcher()),
            StarTrackerSource(config),
            LONGEST["sagitta"],
            confirm_sagitta,
        )

    return one


def unit_target(name: str) -> Target:
    """Return the target of any inertial unit; its simulated device, if there is one, seals."""
    config = imu_config(name)
    seal: Seal = bytes
    longest = MAX_INPUT_BYTES
    if find_spec(f"hil.devices.{name}") is not None:
        device = import_module(f"hil.devices.{name}")
        seal, longest = device.seal, device.LONGEST

    def confirm(frame: bytes) -> None:
        """Require values that are numbers and, of the device's own kind, the same bytes again."""
        datagram = imu_codec(config).decode(Frame(frame, ()))
        if isinstance(datagram, ImuDatagram):
            values = (*(datagram.w_NS_S_rad_s or ()), *(datagram.f_NS_S_m_s2 or ()))
            require(all(map(isfinite, values)), "a value is no number", frame, datagram)
        again = seal(frame)
        is_own = again[:HEAD_BYTES] == frame[:HEAD_BYTES]
        require(again == frame or not is_own, "a datagram has another check value", frame)

    def one(data: bytes) -> None:
        check_stream(
            data, seal, lambda: imu_codec(config).framer, ImuSource(config), longest, confirm
        )

    return one
