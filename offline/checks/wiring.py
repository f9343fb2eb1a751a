"""Compare the frames of described joints with their description, without a model of the robot.

Finds the rate of the frames, a wrong byte order or sign of a number, and a position exchanged with
its own speed. Units and exchanged joints need the robot's dynamics (`mistakes.py`).
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from fsw.config import BusConfig, Config, JointConfig
from fsw.drivers.layout.decoder import Decoder
from fsw.drivers.layout.joints import POSITION, TORQUE, Layout, Use, layouts_of
from fsw.drivers.layout.signals import Message, Number, Signal
from fsw.drivers.wire import NO_FRAMES, FrameArray, joined
from fsw.exchange.sinks import CanTraffic, NullSink
from fsw.exchange.sinks import Message as Traffic
from fsw.messages import FloatArray
from offline.checks.comparison import WRONG, Comparison

MOST_FRAMES = 200_000  # kept of each bus
LEAST_FRAMES = 50  # of a message that is judged
PAUSE_PERIODS = 10.0  # a longer step between frames is a pause
ROUNDS = 4  # of counting lost frames by the rate found so far
RATE_TOLERANCE = 0.02  # of drives whose samples are counted by SYNC or by their own time
JUMP_RATIO = 0.25  # of the whole range of a number: no signal does that between two samples
REACH_RATIO = 2.0  # of the speed limit: a faster step is a jump
FEWER = 0.1  # largest ratio of jumps of another reading that is the correct one
ROUGH, SMOOTHER = 0.02, 20.0  # mean step over the range that is noise; ratio of a better reading
TOP_RATIO = 0.875  # of the range: an unsigned number that stays above may be a negative one
JUMPING, SMOOTH_RATIO = 0.05, 2.0  # share of jumps, and of restlessness, of a torque as position
ALIKE = 0.95  # correlation of one signal with the derivative of another


class Wires(NullSink):
    """Keeps the frames of described joints and judges them."""

    def __init__(self, config: Config) -> None:
        self._config = config
        found = {bus.name: layouts_of(config, bus) for bus in config.buses}
        self._layouts = {name: own for name, own in found.items() if own}
        self._words = {
            name: [message.word for layout in own.values() for message in layout.messages]
            for name, own in self._layouts.items()
        }
        self._kept: dict[str, list[FrameArray]] = {name: [] for name in self._layouts}
        self._counts = dict.fromkeys(self._layouts, 0)

    def put(self, message: Traffic) -> None:
        """Keep the frames of described joints; ignore other messages."""
        if not isinstance(message, CanTraffic) or message.bus not in self._layouts:
            return
        left = MOST_FRAMES - self._counts[message.bus]
        own = message.frames[np.isin(message.frames["word"], self._words[message.bus])][:left]
        self._kept[message.bus].append(own.copy())
        self._counts[message.bus] += len(own)

    def lines(self) -> tuple[list[str], bool]:
        """Return rates and findings as lines of text, and whether the frames fit."""
        rates, found = self.rates(), self.findings()
        lines = [*(own.text() for own in rates), *(f"{WRONG}{text}" for text in found)]
        return lines, not (found or any(own.wrong for own in rates))

    def rates(self) -> list[Comparison]:
        """Return the rate of each bus of described joints: that of the joint farthest from it."""
        found = []
        for i, bus in enumerate(self._config.buses):
            rates_hz = [
                (rate_hz, joint)
                for _, joint, layout, frames in self._joints(bus)
                for first in layout.parts[:1]
                if (rate_hz := frame_rate_hz(frames_of(first.message, frames, first.page)["t_ns"]))
            ]
            if rates_hz:
                farthest = max(rates_hz, key=lambda own: abs(own[0] / bus.rate_hz - 1.0))
                found.append(_rate(f"buses.{i}.rate_hz", bus, *farthest))
        return found

    def findings(self) -> list[str]:
        """Return a line for each signal that is read in a wrong way, or is another quantity."""
        return [
            f"joints.{k}.signals.{text}"
            for bus in self._config.buses
            for k, joint, layout, frames in self._joints(bus)
            for text in _signal_findings(joint, layout, frames, bus.rate_hz)
        ]

    def _joints(self, bus: BusConfig) -> Iterator[tuple[int, JointConfig, Layout, FrameArray]]:
        kept = self._kept.get(bus.name, [])
        frames = joined(kept) if kept else NO_FRAMES
        for k, layout in self._layouts.get(bus.name, {}).items():
            yield k, self._config.joints[k], layout, frames


def frame_rate_hz(t_ns: FloatArray) -> float:
    """Return the rate of periodic frames, of which some may be missing; 0: there are too few.

    The rate is a number of periods over their time; pauses are left out. Stamps may come in bursts.
    """
    steps_s = np.diff(np.asarray(t_ns, np.float64)) * 1e-9
    if len(steps_s) < LEAST_FRAMES or steps_s.sum() <= 0.0:
        return 0.0
    steps_s = steps_s[np.abs(steps_s) <= PAUSE_PERIODS * max(steps_s.mean(), np.median(steps_s))]
    took_s, count = float(steps_s.sum()), float(len(steps_s))
    for _ in range(ROUNDS):  # a step over a missing frame counts as two
        count = float(np.maximum(np.rint(steps_s * count / took_s), 0.0).sum())
    return count / took_s if took_s > 0.0 else 0.0


def _rate(key: str, bus: BusConfig, found_hz: float, joint: JointConfig) -> Comparison:
    timing = joint.timing
    by_arrival = timing is not None and timing.by == "arrival"
    ppm = timing.clock_tolerance_ppm if timing is not None else 0.0
    tolerance = 1e-6 * ppm if by_arrival else RATE_TOLERANCE
    words = f"the frames of {joint.name} come at {found_hz:.6g} Hz; set {key} to that"
    is_off = abs(found_hz / bus.rate_hz - 1.0) > tolerance
    return Comparison(key=key, declared=bus.rate_hz, found=found_hz, wrong=words if is_off else "")


def frames_of(message: Message, frames: FrameArray, page: Signal | None = None) -> FrameArray:
    """Return the frames of a message, whole ones only, in order of time.

    `page`: a signal that is NaN in frames that do not count.
    """
    own = frames[(frames["word"] == message.word) & (frames["length"] >= message.length)]
    if page is not None:
        own = own[~np.isnan(Decoder(message, [page])(own["data"])[0])]
    in_order: FrameArray = own.take(np.argsort(own["t_ns"], kind="stable"))
    return in_order


def _signal_findings(
    joint: JointConfig, layout: Layout, frames: FrameArray, rate_hz: float
) -> Iterator[str]:
    for role, name, step in (
        (POSITION, "position", REACH_RATIO * joint.speed_limit_rad_s / rate_hz),
        (TORQUE, "torque", joint.torque_limit_nm),
    ):
        use = layout.use(role)
        if use is None or (role == POSITION and joint.speed_only):
            continue
        part = next(part for part in layout.parts if use in part.uses)
        own = frames_of(use.message, frames, part.page)
        if len(own) < LEAST_FRAMES:
            continue
        torque = next((each for each in part.uses if each.role == TORQUE), None)
        place = f"{name} ({joint.name}): {use.message.name}.{use.signal.name}"
        most = joint.torque_limit_nm if role == TORQUE else np.inf
        if words := _misread(use, own, step, most):
            yield f"{place} {words}"
        elif role == POSITION and (other := _integral(use, own)):
            yield f"{place} is the speed of {other}: exchanged"
        elif role == POSITION and (other := _smoother(use, torque, own, step)):
            yield f"{place} jumps more often than {other}, its torque: are the two exchanged?"


def _misread(use: Use, frames: FrameArray, step: float, most: float) -> str:
    """Return in words a better way to read the bits of a signal; empty if no way is better.

    Parameters
    ----------
    step, most : largest step between two samples and largest value, in SI units
    """
    ways = {"": use.signal, **_ways(use.message, use.signal)}
    signals = list(ways.values())
    columns = Decoder(use.message, signals)(frames["data"])
    range_si = 2.0**use.signal.bits * abs(use.signal.scale * use.factor)
    jumps, roughness = {}, {}
    for words, signal, column in zip(ways, signals, columns, strict=True):
        values = np.asarray(column, np.float64) * use.factor
        jumps[words] = _jumps(values, signal, range_si, step, most)
        with np.errstate(all="ignore"):
            roughness[words] = float(np.abs(np.diff(values)).mean()) / range_si
    best = min(ways, key=lambda words: (jumps[words], roughness[words]))
    count = round(jumps[""] * len(frames))
    if count and jumps[best] <= FEWER * jumps[""]:
        return f"jumps at {count} of {len(frames)} frames, and does not {best}"
    if use.signal.number == "float":
        return ""
    best = min(ways, key=lambda words: roughness[words])
    if roughness[""] > max(ROUGH, SMOOTHER * roughness[best]):
        share = 100.0 * roughness[""]
        return f"is noise over {share:.0f} % of its range, and is not {best}"
    top = np.asarray(columns[0], np.float64) - use.signal.offset
    is_top = bool((top > TOP_RATIO * 2.0**use.signal.bits * abs(use.signal.scale)).all())
    is_turn = abs(range_si / (2.0 * np.pi) - 1.0) < 1e-3  # then it is the same angle
    if use.signal.number == "unsigned" and not use.signal.offset and is_top and not is_turn:
        stays = f"stays at {top.mean() * use.factor:.4g}, near the top of its range"
        return f"{stays}, and does not as a signed number"
    return ""


def _jumps(values: FloatArray, signal: Signal, range_si: float, step: float, most: float) -> float:
    """Return the share of samples that no such signal can have."""
    with np.errstate(all="ignore"):
        steps = np.abs(np.diff(values))
        is_integer = signal.number != "float"
        reach = step + 2.0 * range_si / 2.0**signal.bits * is_integer
        if is_integer:
            reach = min(reach, JUMP_RATIO * range_si)
        bad = ~(steps <= reach) | ~(np.abs(values[1:]) <= most)
    return float(bad.mean())


def _ways(message: Message, signal: Signal) -> Mapping[str, Signal]:
    """Return other ways to read the bits of a signal, by the words that say how."""
    ways: dict[str, Signal] = {}
    number = signal.number
    sign: Number = "signed" if number == "unsigned" else "unsigned"
    if number != "float":
        article = "a" if sign == "signed" else "an"
        ways[f"as {article} {sign} number"] = replace(signal, number=sign)
    order = "little" if signal.big_endian else "big"
    for start in dict.fromkeys((_same_bytes(signal), signal.start)):
        turned = replace(signal, big_endian=not signal.big_endian, start=start)
        if start < 0 or max(turned.places()) >= 8 * message.length or min(turned.places()) < 0:
            continue
        ways.setdefault(f"in {order}-endian byte order", turned)
        if number != "float":
            ways.setdefault(
                f"as {sign} number in {order}-endian byte order", replace(turned, number=sign)
            )
    return ways


def _same_bytes(signal: Signal) -> int:
    """Return the start of a signal of whole bytes in the other byte order."""
    return signal.start - 7 if signal.big_endian else signal.start + 7


def _integral(use: Use, frames: FrameArray) -> str:
    """Return the name of a signal of the message whose derivative the declared one is."""
    others = [
        own
        for own in use.message.signals
        if own.name != use.signal.name and not own.selector and own.bits >= 8
    ]
    columns = Decoder(use.message, [use.signal, *others])(frames["data"])
    declared, *rest = (np.asarray(own, np.float64) for own in columns)
    for signal, values in zip(others, rest, strict=True):
        if (
            _alike(np.gradient(values), declared) > ALIKE
            and abs(_alike(np.gradient(declared), values)) < ALIKE
        ):
            return signal.name
    return ""


def _smoother(use: Use, torque: Use | None, frames: FrameArray, step: float) -> str:
    """Return the name of the torque of the same message if it is the smoother one; else nothing."""
    if torque is None or torque.message.word != use.message.word:
        return ""
    columns = Decoder(use.message, [use.signal, torque.signal])(frames["data"])
    declared, other = (np.asarray(own, np.float64) for own in columns)
    is_jumping = np.mean(np.abs(np.diff(declared)) * abs(use.factor) > step) > JUMPING
    is_smoother = SMOOTH_RATIO * _restlessness(other) < _restlessness(declared)
    return torque.signal.name if is_jumping and is_smoother else ""


def _restlessness(values: FloatArray) -> float:
    """Return the mean step over the range of the values: small for a motion, large for noise."""
    extent = float(np.ptp(values))
    return float(np.abs(np.diff(values)).mean()) / extent if extent > 0.0 else np.inf


def _alike(one: FloatArray, other: FloatArray) -> float:
    if not (np.isfinite(one).all() and np.isfinite(other).all() and one.std() and other.std()):
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])
