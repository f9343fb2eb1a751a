"""Times by request and by TIME: real bytes of drives, and frames whose true times are known."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from fsw.config.signals import TimingConfig
from fsw.drivers.sources.cues import HELD, Cues
from fsw.drivers.sources.validity import REFUSED
from fsw.drivers.wire import CanFrame, frame_array
from fsw.errors import ConfigError
from fsw.messages import joined
from tests.support.bus_traffic import cut
from tests.unit.fsw.drivers.sources.test_described import T0, made, use

MS = 1_000_000
TORQUE_NM = 17.0 / 0x7FFF
PERIOD_NS = 10 * MS
REPLY = bytes.fromhex("7FFF7FDA803100F0")  # position 0, velocity -37, torque +50 steps, 24.0 degC


def robstride(number: int, **timing: Any) -> dict[str, Any]:
    """Return a drive whose fields stand around 0x7FFF, and its one message."""
    fields = [
        {"name": "position", "start": 7, "bits": 16, "scale": 12.566 / 0x7FFF, "offset": -12.566},
        {"name": "torque", "start": 39, "bits": 16, "scale": TORQUE_NM, "offset": -17.0},
    ]
    message = f"motor{number}"
    joint = {
        "signals": {
            "position": use(message, "position", unit="rad"),
            "torque": use(message, "torque", unit="N m"),
        },
        "timing": {"by": "request", "requests": [0x0300FD00 + number], "sigma_s": 1e-4} | timing,
    }
    signals = [field | {"order": "big"} for field in fields]
    own = {"name": message, "id": 0x028000FD + (number << 8), "extended": True, "length": 8}
    return {"joint": joint, "message": own | {"signals": signals}}


def source_of(tmp_path: Path, count: int = 2, bus: dict[str, Any] | None = None, **timing: Any):
    drives = [robstride(1 + k, **timing) for k in range(count)]
    messages = [drive["message"] for drive in drives]
    own = {"messages": messages, "listen_only": True} | (bus or {})
    return made(tmp_path, own, [drive["joint"] for drive in drives])


def exchange(number: int, at_ns: int, *, reply: bool = True) -> list[CanFrame]:
    asked = CanFrame(at_ns, 0x0300FD00 + number, bytes(8), is_extended=True)
    answer = CanFrame(at_ns + 240_000, 0x028000FD + (number << 8), REPLY, is_extended=True)
    return [asked, answer] if reply else [asked]


def test_a_reply_is_as_old_as_its_request_and_each_drive_has_its_own(tmp_path):
    source = source_of(tmp_path, delay_s=3e-5)
    times = {k: T0 + k * 300_000 + PERIOD_NS * np.arange(50) for k in (1, 2)}
    frames = [frame for k in (1, 2) for t in times[k].tolist() for frame in exchange(k, t)]
    frames.sort(key=lambda frame: frame.t_ns)
    samples = source.feed(frame_array(frames))
    for k in (1, 2):
        own = samples.joint == k - 1
        np.testing.assert_array_equal(samples.t_ns[own], times[k] - 30_000)
        np.testing.assert_allclose(samples.position_rad[own], 0.0, atol=1e-9)
        np.testing.assert_allclose(samples.torque_nm[own], 50 * TORQUE_NM, atol=1e-9)
    assert source.counters["other_frames"] == 0


def test_the_latch_offset_of_the_bus_is_that_of_a_request(tmp_path):
    source = source_of(tmp_path, 1, {"latch_offset_s": 1e-4})
    samples = source.feed(frame_array(exchange(1, T0)))
    assert samples.t_ns.tolist() == [T0 + 100_000]


def test_a_request_without_a_reply_is_a_lost_sample_and_a_late_reply_is_refused(tmp_path):
    source, at = source_of(tmp_path, 1), T0 + PERIOD_NS * np.arange(20)
    frames = [f for k, t in enumerate(at.tolist()) for f in exchange(1, t, reply=k != 7)]
    orphan = CanFrame(int(at[-1]) + 9_500_000, 0x028001FD, REPLY, is_extended=True)
    source.feed(frame_array([*frames, orphan]))
    counters = source.counters
    assert (counters["accepted"], counters["lost"], counters["reject_stale"]) == (19, 1, 1)


def test_a_second_reply_to_one_request_is_refused(tmp_path):
    source = source_of(tmp_path, 1)
    again = CanFrame(T0 + 400_000, 0x028001FD, REPLY, is_extended=True)
    samples = source.feed(frame_array([*exchange(1, T0), again]))
    assert (len(samples), source.counters["reject_sequence"]) == (1, 1)


def time_frame(t_ns: int, ms: int, days: int = 15_671) -> CanFrame:
    return CanFrame(t_ns, 0x100, struct.pack("<IH", 0xF0000000 | ms, days))


def timed(tmp_path: Path, **timing: Any):
    """Return the source of a drive that sends position, torque and its time of day [ms]."""
    fields = [("position", "float"), ("torque", "float")]
    signals = [
        {"name": name, "start": 32 * k, "bits": 32, "number": number}
        for k, (name, number) in enumerate(fields)
    ]
    messages = [
        {"name": "values", "id": 0x181, "length": 8, "signals": signals},
        {
            "name": "clock",
            "id": 0x481,
            "length": 4,
            "signals": [{"name": "ms", "start": 0, "bits": 32, "unit": "ms"}],
        },
    ]
    joint = {
        "signals": {
            "position": use("values", "position", unit="rad"),
            "torque": use("values", "torque", unit="N m"),
            "time": use("clock", "ms"),
        },
        "timing": {"by": "time", "sigma_s": 3e-4} | timing,
    }
    return made(tmp_path, {"messages": messages}, [joint])


def story(rng: np.random.Generator, ms0: int, ppm: float) -> tuple[list[CanFrame], np.ndarray]:
    """Return TIME each second, and 400 samples sent up to 50 ms after they were taken."""
    rate = 1.0 + ppm * 1e-6
    true_ns = T0 + 500 * MS + 10 * MS * np.arange(400) + rng.uniform(0.0, MS, 400)
    frames = []
    for k in range(6):
        late_ns = 95_000 + rng.exponential(20_000)
        at_ns = round(T0 + k * 1e9 / rate + late_ns)
        frames.append(
            time_frame(
                at_ns, (ms0 + 1000 * k) % 86_400_000, 15_671 + (ms0 + 1000 * k) // 86_400_000
            )
        )
    for t_ns in true_ns.tolist():
        own_ms = int(ms0 + (t_ns - T0) * 1e-6 * rate) % 86_400_000
        sent_ns = round(t_ns + 3 * MS + rng.exponential(MS))
        values = struct.pack("<ff", 0.1, 2.0)
        frames.append(CanFrame(sent_ns, 0x181, values))
        frames.append(CanFrame(sent_ns + 120_000, 0x481, struct.pack("<I", own_ms)))
    return sorted(frames, key=lambda frame: frame.t_ns), true_ns


@pytest.mark.parametrize("ms0", [43_200_000, 86_400_000 - 2_500])  # noon; midnight is passed
def test_a_time_of_day_on_the_clock_of_time(tmp_path, ms0):
    frames, true_ns = story(np.random.default_rng(4), ms0, 80.0)
    source = timed(tmp_path)
    samples = source.feed(frame_array(frames))
    assert (len(samples), source.counters["rejected"], source.counters["lost"]) == (400, 0, 0)
    error_s = (samples.t_ns - true_ns) * 1e-9
    assert np.abs(error_s).max() < 0.7e-3  # half a step, and the rate before it is known
    assert np.abs(error_s[200:]).max() < 0.55e-3
    assert np.std(error_s[200:]) < 3.2e-4  # 1 ms / sqrt(12) is 2.9e-4


def test_batches_do_not_matter(tmp_path):
    rng = np.random.default_rng(5)
    frames, _ = story(rng, 86_400_000 - 2_500, -120.0)
    whole, parts = timed(tmp_path), timed(tmp_path)
    once = whole.feed(frame_array(frames))
    many = joined([parts.feed(frame_array(frames[own])) for own in cut(rng, len(frames), 9.0)])
    np.testing.assert_array_equal(once.t_ns, many.t_ns)
    assert whole.counters == parts.counters


def test_noon_on_the_wire(tmp_path):
    """28 bits of ms: 43 200 000 is 0x02932E00; the upper four bits do not count."""
    told = CanFrame(T0, 0x100, bytes.fromhex("002E93F2373D"))
    values = CanFrame(T0 + 5 * MS, 0x181, struct.pack("<ff", 0.1, 2.0))
    clock = CanFrame(T0 + 5 * MS + 120_000, 0x481, (43_200_002).to_bytes(4, "little"))
    samples = timed(tmp_path, delay_s=1e-3).feed(frame_array([told, values, clock]))
    assert samples.t_ns[0] == pytest.approx(T0 - 95_000 + 2_500_000 - 1_000_000, abs=500)


@pytest.mark.parametrize("told", ["none", "old", "short"])
def test_without_a_good_time_a_sample_has_none(tmp_path, told):
    frames, _ = story(np.random.default_rng(6), 1000, 0.0)
    own = [f for f in frames if f.can_id != 0x100][:20]
    before = {
        "none": [],
        "old": [time_frame(T0 - 61_000 * MS, 0)],
        "short": [CanFrame(T0, 0x100, bytes(5))],
    }[told]
    source = timed(tmp_path)
    assert len(source.feed(frame_array([*before, *own]))) == 0
    assert source.counters["reject_stale"] == 10


def test_a_time_of_another_day_part_is_refused(tmp_path):
    told = time_frame(T0, 10_000)
    values = CanFrame(T0 + 5 * MS, 0x181, struct.pack("<ff", 0.1, 2.0))
    clock = CanFrame(T0 + 6 * MS, 0x481, struct.pack("<I", 8_000))
    source = timed(tmp_path)
    assert len(source.feed(frame_array([told, values, clock]))) == 0


@pytest.mark.parametrize(
    ("timing", "words"),
    [
        ({"by": "request", "sigma_s": 1e-4}, "requests: missing with timing by request"),
        ({"by": "arrival", "sigma_s": 1e-4, "requests": [1]}, "requests: must be left out"),
        ({"by": "request", "requests": [1]}, "sigma_s: missing; timing by request needs it"),
        ({"by": "time"}, "sigma_s: missing; timing by time needs it"),
    ],
)
def test_keys_that_do_not_go_together(timing, words):
    with pytest.raises(ValidationError, match=words):
        TimingConfig(**timing)


def test_an_error_below_the_step_of_the_time_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"timing.sigma_s: 0.0001; must be at least 0.00028"):
        timed(tmp_path, sigma_s=1e-4)


def test_a_cue_that_is_forgotten_has_no_stamp():
    cues = Cues([0x80])
    for batch in np.arange(4 * HELD, dtype=np.int64).reshape(4, HELD):
        cues.note(1 + batch)
    known = np.array([REFUSED, 0, 2 * HELD - 1, 2 * HELD, 4 * HELD - 1])
    assert cues.stamps_ns(known).tolist() == [0, 0, 0, 1 + 2 * HELD, 4 * HELD]
