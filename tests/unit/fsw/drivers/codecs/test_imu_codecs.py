"""What every codec of an inertial unit does with damaged bytes; devices encode independently."""

from functools import cache
from importlib import import_module

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.drivers.codecs.imu_datagram import ImuCodec, ImuDatagram
from fsw.drivers.codecs.kvh import KvhCodec
from fsw.drivers.codecs.novatel import NovatelCodec
from fsw.drivers.codecs.vectornav import VectorNavCodec
from fsw.drivers.codecs.xsens import XsensCodec
from fsw.drivers.wire import ByteChunk
from hil.devices.imu_wire import Batch, Wire
from tests.support.codecs import decoded
from tests.support.plant_cases import sensor_config

CODECS = {
    "kvh": lambda: KvhCodec(500.0, "delta", "value"),
    "novatel": NovatelCodec,
    "vectornav": VectorNavCodec,
    "xsens": XsensCodec,
}
SETTINGS = [
    ("kvh", {}),
    ("kvh", {"rotation": "rate", "acceleration": "delta"}),
    ("novatel", {}),
    ("vectornav", {}),
    ("vectornav", {"fields": "delta"}),
    ("xsens", {}),
    ("xsens", {"items": "delta"}),
]
STEP_S = 2e-3


@cache
def sent(name: str, count: int, **options: str) -> tuple[Wire, Batch, list[bytes]]:
    """Return the wire of a simulated device, samples, and their datagrams."""
    config = sensor_config(imu={"device": name, "device_options": options}).imu
    wire, rng = import_module(f"hil.devices.{name}").Wire(config), np.random.default_rng(3)
    batch = Batch(
        number=np.arange(count),
        counter0=9,
        period_s=STEP_S,
        w_NS_S_rad_s=rng.normal(0.0, 0.1, (count, 3)),
        f_NS_S_m_s2=rng.normal(0.0, 5.0, (count, 3)),
        latency_us=np.zeros(count, np.int64),
        starting=np.zeros(count, np.bool_),
    )
    return wire, batch, wire.encode(batch)


def codec_of(name: str, options: dict[str, str]) -> ImuCodec:
    return KvhCodec(500.0, **options) if name == "kvh" else CODECS[name]()


@pytest.mark.parametrize(("name", "options"), SETTINGS)
def test_the_codec_reads_what_the_device_measured(name, options):
    wire, batch, datagrams = sent(name, 20, **options)
    codec = codec_of(name, dict(wire.options))
    found = decoded(codec, b"".join(datagrams))
    assert max(map(len, datagrams)) == wire.length <= codec.frame_bytes[1]
    assert min(map(len, datagrams)) >= codec.frame_bytes[0]
    ticks = np.diff([d.counter for d in found]) * codec.tick_s
    np.testing.assert_allclose(ticks, STEP_S, rtol=1e-6)
    for d, w, f in zip(found, batch.w_NS_S_rad_s, batch.f_NS_S_m_s2, strict=True):
        gyro_s = STEP_S if d.gyro_interval_s is None else 1.0
        acc_s = STEP_S if d.acc_interval_s is None else 1.0
        np.testing.assert_allclose(np.array(d.w_NS_S_rad_s) / gyro_s, w, atol=5e-6)
        np.testing.assert_allclose(np.array(d.f_NS_S_m_s2) / acc_s, f, atol=1e-4)


@pytest.mark.parametrize("name", CODECS)
def test_the_device_writes_what_was_published(name):
    device = import_module(f"hil.devices.{name}")
    assert device.seal(device.VECTOR) == device.VECTOR


@pytest.mark.parametrize("name", CODECS)
def test_every_single_bit_flip_is_rejected(name):
    _, _, datagrams = sent(name, 40)
    good, rest = datagrams[0], b"".join(datagrams[1:])
    for bit in range(8 * len(good)):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        codec = CODECS[name]()
        frames = codec.framer.feed(ByteChunk(0, bytes(bad) + rest))
        assert [frame.data for frame in frames] == datagrams[1:], bit


@pytest.mark.parametrize("name", CODECS)
def test_a_stream_does_not_depend_on_its_pieces_and_survives_junk(name):
    _, _, datagrams = sent(name, 30)
    junk = np.random.default_rng(5).bytes(200)
    stream = junk + datagrams[0][:11] + b"".join(datagrams)
    codec = CODECS[name]()
    found = [f for byte in stream for f in codec.framer.feed(ByteChunk(0, bytes((byte,))))]
    assert [frame.data for frame in found] == datagrams
    assert codec.framer.skipped_bytes == 211


@pytest.mark.parametrize("name", CODECS)
@given(st.lists(st.one_of(st.binary(max_size=60), st.integers(0, 9)), max_size=12))
def test_damaged_bytes_never_raise_and_are_conserved(name, parts):
    _, _, datagrams = sent(name, 10)
    device, codec = import_module(f"hil.devices.{name}"), CODECS[name]()
    in_frames = 0
    pieces = [datagrams[p] if isinstance(p, int) else p for p in parts]
    pieces += [device.seal(piece) for piece in pieces]
    for piece in pieces:
        for frame in codec.framer.feed(ByteChunk(0, piece)):
            in_frames += len(frame.data)
            d = codec.decode(frame)
            if isinstance(d, ImuDatagram):
                assert np.isfinite([*(d.w_NS_S_rad_s or ()), *(d.f_NS_S_m_s2 or ())]).all()
    framer = codec.framer
    assert in_frames + framer.skipped_bytes + framer.pending_bytes == framer.received_bytes
    assert framer.pending_bytes <= device.LONGEST
