"""`fsw import` of CAN logs of many tools: times read right or doubted, and nothing lost unsaid.

The candump log that python-can's own writer makes of the same frames is the reference throughout.
"""

import re
from collections.abc import Callable
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import can
import pytest

from tests.support.import_cases import (
    START_S,
    Import,
    frames,
    importing,  # noqa: F401
    stamps_ns,
    write_log,
)

COUNT = 1000  # frames of a log
HEADER = "date Thu Oct 09 08:53:30.000 2025\nbase hex  timestamps absolute\n"
NO_EVENTS = "no internal events logged\n"


@pytest.fixture(autouse=True)
def _utc(monkeypatch: pytest.MonkeyPatch) -> None:
    import time

    monkeypatch.setenv("TZ", "UTC")
    time.tzset()


@pytest.fixture
def arm(importing: Callable[..., Import]) -> Import:  # noqa: F811
    return importing()


def reference(arm: Import, start_s: float = START_S) -> list[int]:
    assert arm.can(write_log(arm.folder / "reference.log", start_s)) == 0
    found = stamps_ns(arm.out)
    arm.out.unlink()
    return found


def asc_lines(start_s: float = 0.0) -> list[str]:
    """Return the frames as lines of an ASC log, stamps from `start_s` on."""
    return [
        f"   {message.timestamp - START_S + start_s:.6f} 1  {message.arbitration_id:X}"
        f"             Rx   d {len(message.data)} {message.data.hex(' ').upper()}\n"
        for message in frames()
    ]


def test_force_replaces_a_recording_and_only_force(arm):
    log = write_log(arm.folder / "a.log")
    assert arm.can(log) == 0
    first = arm.out.read_bytes()
    assert arm.can(log) == 2
    assert "--force overwrites it" in arm.refused[0]
    assert arm.out.read_bytes() == first
    later = write_log(arm.folder / "b.log", START_S + 5.0)
    assert arm.can(later, "--force") == 0
    assert stamps_ns(arm.out)[0] == round((START_S + 5.0) * 1e9)


def test_a_jump_of_the_clock_is_named(arm, monkeypatch):
    """A computer starts in 1970 until its time is set."""
    monkeypatch.setattr("fsw.scheduler.align.MOST_EMPTY", 9)  # windows of a gap that are replayed
    log = arm.folder / "jump.log"
    with can.Logger(log) as writer:
        for message in (*frames(500, 10.0), *frames(500)):
            writer.on_message_received(message)
    assert arm.can(log) == 0
    assert stamps_ns(arm.out)[0] == 10 * 10**9
    gaps_s = re.findall(r"no sample for (\S+) s: .*; did the clock jump\?", "\n".join(arm.refused))
    assert max(map(float, gaps_s)) > 0.9 * START_S


def test_force_keeps_the_old_recording_when_the_new_log_is_refused(arm):
    assert arm.can(write_log(arm.folder / "a.log")) == 0
    first = arm.out.read_bytes()
    (arm.folder / "empty.log").write_text("")
    assert arm.can(arm.folder / "empty.log", "--force") == 2
    assert arm.out.read_bytes() == first
    assert not list(arm.folder.glob("out.tmp"))


def test_force_never_overwrites_a_file_that_is_read(arm):
    log = write_log(arm.folder / "a.log")
    before = log.read_bytes()
    arm.out = log
    assert arm.can(log, "--force") == 2
    assert "is read by this command" in arm.refused[0]
    assert log.read_bytes() == before


@pytest.mark.parametrize("ms", [0, 1, 7, 42, 99, 100, 250, 999])
def test_the_start_of_an_asc_log_of_python_can_is_read_to_the_millisecond(arm, ms):
    start_s = START_S + ms * 1e-3
    expected = reference(arm, start_s)
    assert arm.can(write_log(arm.folder / "a.asc", start_s)) == 0
    assert stamps_ns(arm.out) == expected
    moment = (
        datetime.fromtimestamp(start_s, UTC).replace(tzinfo=None).isoformat(" ", "milliseconds")
    )
    assert f"starts {moment}" in arm.said
    assert "to 1 ms" in arm.said
    assert ("two digits" in arm.said or "one digit" in arm.said) == (0 < ms < 100)


def test_microseconds_that_an_asc_header_cannot_hold_are_a_doubt_that_is_said(arm):
    start_s = START_S + 0.042637
    expected = reference(arm, start_s)
    assert arm.can(write_log(arm.folder / "a.asc", start_s)) == 0
    late = {ours - theirs for ours, theirs in zip(stamps_ns(arm.out), expected, strict=True)}
    assert late == {-637_000}
    assert "known to 1 ms" in arm.said


@pytest.mark.parametrize("suffix", [".blf", ".trc"])
def test_logs_of_other_forms_have_the_stamps_of_the_candump_log(arm, suffix):
    start_s = START_S + 0.042637
    expected = reference(arm, start_s)
    assert arm.can(write_log(arm.folder / f"a{suffix}", start_s)) == 0
    assert stamps_ns(arm.out) == expected


def test_a_header_in_seconds_is_known_to_a_second(arm):
    text = HEADER.replace("30.000", "30") + NO_EVENTS + "".join(asc_lines())
    (arm.folder / "a.asc").write_text(text)
    assert arm.can(arm.folder / "a.asc") == 0
    assert "known to 1 s" in arm.said


@pytest.mark.parametrize("events", [NO_EVENTS, "// version 7.1.0\n", ""])
def test_every_frame_below_any_header_is_read(arm, events):
    """Without `internal events logged` python-can's reader loses the first frame."""
    (arm.folder / "a.asc").write_text(HEADER + events + "".join(asc_lines()))
    assert arm.can(arm.folder / "a.asc") == 0
    assert stamps_ns(arm.out) == reference_of(arm)


def reference_of(arm: Import) -> list[int]:
    arm.out.unlink()
    return reference(arm)


def test_frames_before_a_trigger_block_and_before_zero_are_read(arm):
    """The buffer before a trigger has negative stamps; python-can's reader drops them unsaid."""
    trigger = "Begin Triggerblock Thu Oct 09 08:53:30.000 2025\n   0.000000 Start of measurement\n"
    text = HEADER + NO_EVENTS + trigger + "".join(asc_lines(-0.4))
    (arm.folder / "a.asc").write_text(text + "End TriggerBlock\n")
    assert arm.can(arm.folder / "a.asc") == 0
    assert [t + 400_000_000 for t in stamps_ns(arm.out)] == reference_of(arm)
    lines = asc_lines()
    text = HEADER + NO_EVENTS + "".join(lines[:300]) + trigger + "".join(lines[300:])
    (arm.folder / "a.asc").write_text(text)
    assert arm.can(arm.folder / "a.asc", "--force") == 0
    assert stamps_ns(arm.out) == reference_of(arm)


def test_a_second_trigger_block_continues_the_clock_of_the_first_if_its_stamps_do(arm):
    lines = asc_lines()
    begin = "Begin Triggerblock Thu Oct 09 08:53:{} 2025\n"
    text = HEADER + NO_EVENTS + begin.format("30.000") + "".join(lines[:500])
    text += "End TriggerBlock\n" + begin.format("30.400") + "".join(lines[500:])
    (arm.folder / "a.asc").write_text(text + "End TriggerBlock\n")
    assert arm.can(arm.folder / "a.asc") == 0
    assert stamps_ns(arm.out) == reference_of(arm)
    own = "".join(asc_lines()[:500])
    text = HEADER + NO_EVENTS + begin.format("30.000") + own + "End TriggerBlock\n"
    text += begin.format("35.000") + own + "End TriggerBlock\n"
    (arm.folder / "a.asc").write_text(text)
    assert arm.can(arm.folder / "a.asc", "--force") == 0
    found = stamps_ns(arm.out)
    assert found[500] - found[0] == 5_000_000_000


def test_stamps_far_from_the_start_of_the_header_are_doubted(arm):
    (arm.folder / "a.asc").write_text(HEADER + NO_EVENTS + "".join(asc_lines(40874.8)))
    assert arm.can(arm.folder / "a.asc") == 0
    assert "first frame 40874.8 s after the start" in arm.said


@pytest.mark.parametrize("shift", ["1e12", "-1e12", "9e9", "-1e10", "1e300", "inf", "nan"])
def test_a_shift_beyond_all_times_is_one_line(arm, shift):
    assert arm.can(write_log(arm.folder / "a.log"), "--shift", f"arm={shift}") == 2
    assert arm.is_refused("shift")


def test_an_asc_log_with_relative_stamps_is_refused(arm):
    text = HEADER.replace("absolute", "relative") + NO_EVENTS + "".join(asc_lines())
    (arm.folder / "a.asc").write_text(text)
    assert arm.can(arm.folder / "a.asc") == 2
    assert arm.is_refused("a.asc", "timestamps relative", "absolute")


def differences(lines: list[str]) -> str:
    """Return a candump log whose stamps are the times since the line before, as of `-td`."""
    stamps = [float(re.match(r"\(([\d.]+)\)", line)[1]) for line in lines]
    steps = [0.0, *(b - a for a, b in pairwise(stamps))]
    return "".join(
        f"({step:010.6f}){line[line.index(')') + 1 :]}"
        for step, line in zip(steps, lines, strict=True)
    )


@pytest.mark.parametrize("slower", [1, 20])
def test_a_log_whose_stamps_are_differences_is_refused(arm, slower):
    log = write_log(arm.folder / "a.log")
    lines = log.read_text().splitlines(keepends=True)
    if slower > 1:  # steps beyond the disorder that is accepted
        lines = [
            re.sub(r"\(([\d.]+)\)", lambda m: f"({float(m[1]) * slower % 1e6:.6f})", line)
            for line in lines
        ]
    log.write_text(differences(lines))
    assert arm.can(log) == 2
    assert arm.is_refused("a.log", "1000 frames", "buses.0.rate_hz", "differences")


@pytest.mark.parametrize(("factor", "hz"), [(2.0, "125"), (0.5, "500")])
def test_a_clock_that_contradicts_the_declared_rate_is_refused(arm, factor, hz):
    log = write_log(arm.folder / "a.log")
    text = re.sub(
        r"\(([\d.]+)\)",
        lambda m: f"({START_S + factor * (float(m[1]) - START_S):.6f})",
        log.read_text(),
    )
    log.write_text(text)
    assert arm.can(log) == 2
    assert arm.is_refused(f"SYNC come at {hz} Hz", "buses.0.rate_hz is 250")


def test_pauses_and_bursts_of_a_logger_do_not_contradict_the_rate(arm):
    """A USB adapter hands over frames in bursts of 16 ms, and the logging paused for 20 s."""
    log = write_log(arm.folder / "a.log")

    def moved(match: re.Match[str]) -> str:
        t_s = float(match[1]) - START_S
        return f"({START_S + (t_s // 0.016) * 0.016 + 20.0 * (t_s > 0.4):.6f})"

    log.write_text(re.sub(r"\(([\d.]+)\)", moved, log.read_text()))
    assert arm.can(log) == 0


@pytest.mark.parametrize("suffix", [".log", ".asc", ".trc"])
def test_damaged_lines_in_the_middle_are_counted_and_the_rest_is_read(arm, suffix):
    log = write_log(arm.folder / f"a{suffix}")
    lines = log.read_text().splitlines(keepends=True)
    for at in (300, 301, 650):
        lines[at] = lines[at].rstrip("\n")[:-1].replace("Rx", "Rx d 8 zz zz") + "ZZ\n"
    log.write_text("".join(lines))
    assert arm.can(log) == 0
    assert len(stamps_ns(arm.out)) == COUNT - 3
    assert "lines not read: 3, the first is line 301" in arm.said


def test_a_request_to_send_is_no_frame_and_is_counted(arm):
    lines = asc_lines()
    lines.insert(40, lines[40].replace("Rx  ", "TxRq"))
    (arm.folder / "a.asc").write_text(HEADER + NO_EVENTS + "".join(lines))
    assert arm.can(arm.folder / "a.asc") == 0
    assert len(stamps_ns(arm.out)) == COUNT
    assert "lines not read: 1" in arm.said


def test_events_of_an_asc_log_that_are_no_frames_raise_no_alarm(arm):
    lines = asc_lines()
    lines[50:50] = [
        "   0.020100 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%\n",
        "   0.020200 CAN 1 Status:chip status error active\n",
        "// a comment\n",
        "   0.020300 log trigger event\n",
    ]
    (arm.folder / "a.asc").write_text(HEADER + NO_EVENTS + "".join(lines))
    assert arm.can(arm.folder / "a.asc") == 0
    assert "not read" not in arm.said
    assert len(stamps_ns(arm.out)) == COUNT


SCREEN = {  # of candump's options, the text of a stamp; None: refused
    "-ta": lambda t: f" ({t:.6f})",
    "-tA": lambda t: f" ({datetime.fromtimestamp(t, UTC):%Y-%m-%d %H:%M:%S.%f})",
    "-tz": lambda t: f" ({t - START_S:010.6f})",
}


def screen(stamp: Callable[[float], str], extra: str = "") -> str:
    return "".join(
        f"{stamp(message.timestamp)}  can0  {extra}{message.arbitration_id:03X}   "
        f"[{len(message.data)}]  {message.data.hex(' ').upper()}\n"
        for message in frames()
    )


@pytest.mark.parametrize("name", ["dump.log", "dump.txt"])
@pytest.mark.parametrize("option", SCREEN)
def test_what_candump_prints_on_the_screen_is_read(arm, option, name):
    expected = reference(arm)
    (arm.folder / name).write_text(screen(SCREEN[option], "RX - -  " * (name == "dump.txt")))
    assert arm.can(arm.folder / name) == 0
    offset = round(START_S * 1e9) if option == "-tz" else 0
    assert [t + offset for t in stamps_ns(arm.out)] == expected


def test_what_candump_prints_without_stamps_is_refused(arm):
    (arm.folder / "a.log").write_text(screen(lambda _: ""))
    assert arm.can(arm.folder / "a.log") == 2
    assert arm.is_refused("a.log", "no stamps", "candump -L")


def test_what_candump_prints_with_differences_is_refused(arm):
    lines = screen(lambda t: f"({t:.6f})").splitlines(keepends=True)
    (arm.folder / "a.log").write_text(differences(lines))
    assert arm.can(arm.folder / "a.log") == 2
    assert arm.is_refused("a.log", "differences")


def busmaster(mode: str, base: str = "HEX", start_s: float = START_S) -> str:
    """Return the frames as BUSMASTER 3.2.2 logs them."""

    def clock(t: float) -> str:
        tenths = round(t * 1e4)
        seconds = tenths // 10_000
        parts = (
            seconds // 3600 % (24 if mode == "SYSTEM" else 999),
            seconds // 60 % 60,
            seconds % 60,
        )
        return ":".join(f"{part:02d}" for part in parts) + f":{tenths % 10_000:04d}"

    def number(value: int, width: int) -> str:
        return f"{value:0{width}X}" if base == "HEX" else str(value)

    start = datetime.fromtimestamp(start_s, UTC)
    midnight = start.replace(hour=0, minute=0, second=0, microsecond=0).timestamp()
    zero_s = midnight if mode == "SYSTEM" else start_s
    lines = [
        "BUSMASTER Ver 3.2.2",
        "PROTOCOL CAN",
        "NOTE: PLEASE DO NOT EDIT THIS DOCUMENT",
        "[START LOGGING SESSION]",
        f"START DATE AND TIME {start.day}:{start.month}:{start.year} {start.hour}:"
        f"{start.minute}:{start.second}:{start.microsecond // 1000:03d}",
        base,
        f"{mode} MODE",
        "START CHANNEL BAUD RATE",
        "CHANNEL 1 - PCAN-USB Driver Id 16 - 500000 bps",
        "END CHANNEL BAUD RATE",
        "<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>",
    ]
    rows = [
        f"{clock(message.timestamp - zero_s)} Rx 1 "
        f"{'0x' * (base == 'HEX')}{number(message.arbitration_id, 3)} s {len(message.data)} "
        + " ".join(number(byte, 2) for byte in message.data)
        for message in frames(start_s=start_s)
    ]
    end = ["END DATE AND TIME 9:10:2025 8:54:0:0", "[STOP LOGGING SESSION]"]
    text = [*(f"***{line}***" for line in lines), *rows, *(f"***{line}***" for line in end)]
    return "\n".join(text) + "\n"


@pytest.mark.parametrize("base", ["HEX", "DEC"])
@pytest.mark.parametrize("mode", ["SYSTEM", "ABSOLUTE"])
def test_a_log_of_busmaster_is_read(arm, mode, base):
    expected = reference(arm)
    (arm.folder / "a.log").write_text(busmaster(mode, base))
    assert arm.can(arm.folder / "a.log") == 0
    assert stamps_ns(arm.out) == expected  # all stamps are whole tenths of a millisecond
    assert "to 0.1 ms" in arm.said


def test_a_log_of_busmaster_with_relative_stamps_is_refused(arm):
    (arm.folder / "a.log").write_text(busmaster("RELATIVE"))
    assert arm.can(arm.folder / "a.log") == 2
    assert arm.is_refused("a.log", "RELATIVE MODE")


def test_the_clock_of_busmaster_continues_after_midnight(arm):
    midnight_s = datetime(2025, 10, 10, tzinfo=UTC).timestamp()
    expected = reference(arm, midnight_s - 0.4)
    (arm.folder / "a.log").write_text(busmaster("SYSTEM", start_s=midnight_s - 0.4))
    assert arm.can(arm.folder / "a.log") == 0
    assert stamps_ns(arm.out) == expected


@pytest.mark.parametrize("kind", [".log", ".asc", ".trc", ".blf"])
def test_a_file_of_noise_is_one_line(arm, kind):
    path: Path = arm.folder / f"a{kind}"
    for data in (b"\x00" * 500 + b"\n", bytes(range(256)) * 9 + b"\n", b"x" * 200_000 + b"\n"):
        path.write_bytes(data)
        assert arm.can(path) == 2
        assert arm.is_refused(f"a{kind}: ")
