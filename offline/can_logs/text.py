"""Text logs of CAN buses, line by line in a form that python-can's readers decode.

python-can reads the frames. Stamps are read here where python-can's reader loses some of them
(ASC), and where python-can has no reader (BUSMASTER, what candump prints on the screen).
"""

import codecs
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from fsw.errors import ConfigError
from offline.can_logs.asc_clock import AscClock

Line = tuple[int, str]  # number from 1, text
_Dialect = Callable[["TextLog", Iterator[Line]], Iterator[str]]
KNOWN = (".asc", ".csv", ".trc")  # any other suffix is a log of candump or BUSMASTER
BINARY = (".blf", ".db", ".mf4")  # suffixes of logs that are not text
HEAD_LINES = 200  # a header is not longer
_CHARACTERS = 1 << 16  # a longer line is not a frame
_GZIP = b"\x1f\x8b"
_BYTE = re.compile(r"[0-9A-Fa-f]{2}")
_BASE = re.compile(
    r"\s*base\s+(?P<base>hex|dec)(?:\s+timestamps\s+(?P<mode>absolute|relative))?", re.IGNORECASE
)
_ASC_LIKE = re.compile(
    r"\s*-?\d+[.,]\d+\s+(?:CANFD\s|\d+\s+(?:ErrorFrame|[0-9A-F]+x?\s|.*\b(?:Rx|Tx|TxRq)\b))",
    re.IGNORECASE,
)
_ASC_FRAME = re.compile(
    r"\s*(?P<stamp>-?\d+[.,]\d+)\s+"
    r"(?P<rest>CANFD\s.*|\d+\s+ErrorFrame.*|\d+\s+\w+\s+(?:Rx|Tx)\s.*)",
    re.IGNORECASE,
)
_SCREEN = re.compile(
    r"\s*(?:\((?P<stamp>[^)]*)\)\s+)?(?P<channel>[\w.-]+)\s+(?:[TR]X\s+\S\s+\S\s+)?"
    r"(?P<word>[0-9A-F]{3}|[0-9A-F]{8})\s+\[(?P<length>\d+)\](?P<data>.*)"
)
_BUSMASTER = re.compile(
    r"(\d+):(\d+):(\d+):(\d+)\s+(?:Rx|Tx)\s+(?P<channel>\d+)\s+(?P<word>\w+)\s+"
    r"(?P<type>s|x|sr|xr)\s+(?P<length>\d+)(?P<data>.*)",
    re.IGNORECASE,
)
_TENTH_MS_NS = 100_000
_DAY_NS = 86_400 * 10**9


@dataclass(slots=True)
class Unread:
    """Lines that look like data and were not read: how many, and the first of them."""

    count: int = 0
    number: int = 0
    text: str = ""

    def add(self, line: Line) -> None:
        """Count a line."""
        if not self.count:
            self.number, self.text = line
        self.count += 1


@dataclass(slots=True, eq=False)
class TextLog:
    """A text log as a file for one of python-can's readers, one frame a line.

    A reader that raises has consumed the damaged line; a new reader continues below it. `accept`
    says that the newest line gave a frame; a line that gave none is counted in `unread`.
    """

    path: Path
    kind: str  # suffix of the files that the reader is made for
    header: list[str] = field(default_factory=list)  # lines that each reader needs first
    notes: list[str] = field(default_factory=list)
    unread: Unread = field(default_factory=Unread)
    t_ns: int | None = None  # stamp of the newest line; None: the reader decodes it
    line: Line = (0, "")  # newest line of the file
    is_done: bool = False
    texts: Iterator[str] = field(default_factory=lambda: iter(()))  # set once, by `text_log`
    _open: bool = False  # the newest line has been given to the reader and gave no frame yet
    _again: list[str] = field(default_factory=list)

    def repeat_header(self) -> None:
        """Return the header again, for a new reader."""
        self._again = list(self.header)

    def accept(self) -> None:
        """Note that the newest line gave a frame."""
        self._open = False

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        if self._again:
            return self._again.pop(0)
        if self._open:
            self.unread.add(self.line)
            self._open = False
        text = next(self.texts, None)
        if text is None:
            self.is_done = True
            raise StopIteration
        self._open = True
        return text

    def close(self) -> None:
        """Do nothing: the file is closed when its last line has been read."""


def text_log(path: Path) -> TextLog:
    """Return a text log, its dialect found from its suffix and its first lines.

    Raises
    ------
    ConfigError when the file is empty, cut off or not text, or its stamps are not times; OSError.
    """
    _refuse_broken(path)
    head = [text for _, text in zip(range(HEAD_LINES), _lines(path), strict=False)]
    suffix = path.suffix.lower()
    kind = suffix if suffix in KNOWN else ".log"
    log = TextLog(path, kind)
    dialect: _Dialect = _plain
    if kind == ".asc":
        found = next((match for _, text in head if (match := _BASE.match(text))), None)
        if found is not None and (found["mode"] or "").lower() == "relative":
            raise ConfigError(
                f"{path}: its header says 'timestamps relative', times since the event before; "
                "export it with absolute time stamps"
            )
        base = "hex" if found is None else found["base"].lower()
        log.header = [f"base {base} timestamps absolute\n", "no internal events logged\n"]
        dialect = _asc
    elif kind == ".csv":
        log.header = [head[0][1]]
        dialect = _below_header
    elif kind == ".trc":
        log.header = [text for _, text in head if text.startswith(";$")]
        has_start = any(text.startswith(";$STARTTIME") for text in log.header)
        start = "start of its header read as UTC" if has_start else "no start in its header"
        log.notes.append(start + ": stamps count from 0" * (not has_start))
        dialect = _trc
    elif head[0][1].startswith("***"):
        dialect = _busmaster
    elif any(_SCREEN.match(text) for _, text in head):
        dialect = _screen
    log.texts = dialect(log, _numbered(log))
    return log


def _lines(path: Path) -> Iterator[Line]:
    """Yield the lines that are not blank, with their numbers."""
    with path.open(encoding=_encoding(path), errors="replace") as file:
        for number, text in enumerate(iter(lambda: file.readline(_CHARACTERS), ""), 1):
            if text.strip():
                yield number, text


def _numbered(log: TextLog) -> Iterator[Line]:
    for line in _lines(log.path):
        log.line = line
        yield line


def _encoding(path: Path) -> str:
    """Return UTF-8, or what tools of Windows write if the beginning is not UTF-8."""
    with path.open("rb") as file:
        head = file.read(_CHARACTERS)
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _refuse_broken(path: Path) -> None:
    """Raise ConfigError for a file that is empty or no text, or whose last line has no end."""
    with path.open("rb") as file:
        head = file.read(_CHARACTERS)
        file.seek(max(file.seek(0, 2) - 1, 0))
        last = file.read()
    fault = ""
    if not head:
        fault = "it is empty"
    elif head.startswith(_GZIP):
        fault = f"it is compressed; unpack it: gzip -d {path.name}"
    elif b"\0" in head:
        fault = f"it is not text in ASCII or UTF-8; binary logs end with {', '.join(BINARY)}"
    elif last != b"\n":
        fault = "its last line is cut off; end it with a newline, or remove it"
    if fault:
        raise ConfigError(f"{path}: cannot be read as a CAN log: {fault}")


def _plain(_log: TextLog, lines: Iterator[Line]) -> Iterator[str]:
    for _, text in lines:
        yield text


def _below_header(_log: TextLog, lines: Iterator[Line]) -> Iterator[str]:
    next(lines, None)
    for _, text in lines:
        yield text


def _trc(_log: TextLog, lines: Iterator[Line]) -> Iterator[str]:
    for _, text in lines:
        if not text.lstrip().startswith(";"):
            yield text


def _asc(log: TextLog, lines: Iterator[Line]) -> Iterator[str]:
    clock = AscClock(log.path)
    for number, text in lines:
        if clock.reads(number, text) or not _ASC_LIKE.match(text):
            continue
        frame = _ASC_FRAME.match(text)
        if frame is None:
            log.unread.add((number, text))
            continue
        log.t_ns = clock.stamp_ns(float(frame["stamp"].replace(",", ".")))
        yield f"0.0 {frame['rest']}\n"
    log.notes.extend(clock.notes())


def _screen(log: TextLog, lines: Iterator[Line]) -> Iterator[str]:
    is_first = True
    for line in lines:
        found = _SCREEN.match(line[1])
        t_ns = None if found is None else _screen_stamp_ns(found["stamp"])
        if found is not None and found["stamp"] is None and is_first:
            raise ConfigError(
                f"{log.path}: has no stamps; record with candump -L, or with candump -ta"
            )
        is_first = is_first and found is None
        if found is None or t_ns is None:
            log.unread.add(line)
            continue
        log.t_ns = t_ns
        data = found["data"].split()[: int(found["length"])]
        if data[:1] == ["remote"]:
            frame = f"#R{int(found['length'])}"
        elif len(data) < int(found["length"]) or not all(map(_BYTE.fullmatch, data)):
            log.unread.add(line)
            continue
        else:
            flags = "##0" if len(found["length"]) > 1 else "#"  # CAN FD: two digits of length
            frame = flags + "".join(data)
        yield f"(0.0) {found['channel']} {found['word']}{frame}\n"


def _screen_stamp_ns(text: str | None) -> int | None:
    """Return a stamp of candump's -ta, -tz or -td (seconds) or -tA (local date and time)."""
    try:
        seconds = float(text or "")
    except ValueError:
        try:
            seconds = datetime.fromisoformat(text or "").timestamp()
        except (ValueError, OverflowError, OSError):
            return None
    return round(seconds * 1e6) * 1000 if 0.0 <= seconds < 2.0**33 else None


def _busmaster(log: TextLog, lines: Iterator[Line]) -> Iterator[str]:
    start_ns = midnight_ns = before_ns = 0
    base, is_clock = 16, True
    for number, text in lines:
        if text.startswith("***"):
            words = text.strip().strip("*")
            if words == "RELATIVE MODE":
                raise ConfigError(
                    f"{log.path}: its header says RELATIVE MODE, times since the frame before; "
                    "log in SYSTEM or ABSOLUTE MODE"
                )
            if words in ("HEX", "DEC"):
                base = 16 if words == "HEX" else 10
            is_clock = is_clock if words != "ABSOLUTE MODE" else False
            if words.startswith("START DATE AND TIME "):
                start_ns, midnight_ns = _busmaster_start(log.path, (number, words))
                before_ns = 0
            continue
        found = _BUSMASTER.match(text)
        if found is None:
            log.unread.add((number, text))
            continue
        hours, minutes, seconds, tenths = map(int, found.groups()[:4])
        since_ns = (hours * 3600 + minutes * 60 + seconds) * 10**9 + tenths * _TENTH_MS_NS
        t_ns = (midnight_ns if is_clock else start_ns) + since_ns
        if is_clock and before_ns and t_ns < before_ns - _DAY_NS // 2:  # past midnight
            midnight_ns += _DAY_NS
            t_ns += _DAY_NS
        before_ns = log.t_ns = t_ns
        yield _busmaster_frame(found, base)
    log.notes.append("stamps of BUSMASTER, read in this computer's time zone, known to 0.1 ms")


def _busmaster_frame(found: re.Match[str], base: int) -> str:
    """Return a frame of BUSMASTER as candump -L has it; a damaged one is damaged there too."""
    kind, length = found["type"].lower(), int(found["length"])
    data = found["data"].split()[:length]
    try:
        word = int(found["word"].removeprefix("0x"), base)
        body = "".join(f"{int(byte, base):02X}" for byte in data)
    except ValueError:
        return found[0]
    if len(data) < length and "r" not in kind:
        return found[0]
    body = f"R{length}" if "r" in kind else body
    return f"(0.0) {found['channel']} {word:0{8 if 'x' in kind else 3}X}#{body}\n"


def _busmaster_start(path: Path, line: Line) -> tuple[int, int]:
    """Return start and midnight before it [ns] of `START DATE AND TIME 9:10:2025 8:53:30:42`."""
    try:
        numbers = [int(part) for part in re.findall(r"\d+", line[1])]
        day, month, year, hour, minute, second = numbers[:6]
        start = datetime(year, month, day, hour, minute, second)  # noqa: DTZ001 local time
        milliseconds = numbers[6] if len(numbers) > 6 else 0
        seconds, midnight = start.timestamp(), datetime(year, month, day).timestamp()  # noqa: DTZ001
    except (ValueError, OverflowError, OSError) as error:
        raise ConfigError(f"{path}: line {line[0]}: {line[1][:100]!r} is not a date") from error
    return round(seconds * 1000 + milliseconds) * 10**6, round(midnight) * 10**9
