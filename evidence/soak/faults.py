"""Random faults of one segment, fixed by its seed: on the links, and holds of the daemon."""

from collections.abc import Callable

import numpy as np

from hil.devices.can_segment import TimedFrame
from hil.devices.uart import TimedBytes
from hil.faults import taps as faults
from hil.links.virtual import VirtualBench

S = 1_000_000_000
MS = 1_000_000
BYTE_ACTIONS: tuple[faults.ByteAction, ...] = (
    faults.drop,
    faults.duplicate,
    faults.flip,
    faults.truncate,
    faults.behead,
    faults.noise(40),
    faults.delay(3 * MS),
)
FRAME_ACTIONS: tuple[faults.FrameAction, ...] = (
    faults.drop,
    faults.duplicate,
    faults.delay(MS),
    faults.change_frame(length=5),
    faults.change_frame(status=0x0D),
    faults.as_node(0x2A),
)
RATES = (1e-3, 2e-2)
LENGTHS_S = (0.5, 4.0)
MOST_SLIPS = 20  # most grid points of the loop that a hold skips


def apply(bench: VirtualBench, rng: np.random.Generator, length_s: float) -> list[str]:
    """Put two faults on the bus and two on each serial line; return their names."""
    t0_ns = bench.clock.now_ns()
    names = []

    def window() -> tuple[int, int]:
        begin_s = rng.uniform(0.0, length_s)
        return t0_ns + round(begin_s * S), t0_ns + round((begin_s + rng.uniform(*LENGTHS_S)) * S)

    def rate() -> float:
        low, high = np.log(RATES)
        return float(np.exp(rng.uniform(low, high)))

    frame_taps: list[faults.Tap[TimedFrame]] = []
    for k in rng.choice(len(FRAME_ACTIONS), 2, replace=False):
        frame_taps.append(
            faults.Struck(
                FRAME_ACTIONS[k],
                rate(),
                int(rng.integers(1 << 31)),
                only=faults.is_tpdo1,
                window_ns=window(),
            )
        )
        names.append(f"arm {k}")
    bench.can.tap = faults.chain(*frame_taps)
    for name, line in bench.serials.items():
        byte_taps: list[Callable[..., list[TimedBytes]]] = []
        for k in rng.choice(len(BYTE_ACTIONS), 2, replace=False):
            struck: faults.Struck[TimedBytes] = faults.Struck(
                BYTE_ACTIONS[k], rate(), int(rng.integers(1 << 31)), window_ns=window()
            )
            byte_taps.append(struck)
            names.append(f"{name} {k}")
        line.tap = faults.chain(*byte_taps)
    return names


def holds(rng: np.random.Generator, ticks: int) -> dict[int, int]:
    """Return by tick, for three ticks, how many grid points the daemon misses after the tick."""
    at = rng.choice(ticks, size=3, replace=False)
    return {int(tick): int(rng.integers(1, MOST_SLIPS + 1)) for tick in at}
