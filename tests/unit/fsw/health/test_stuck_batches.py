"""Stuck sensors are the same ones however their samples are cut into batches."""

from dataclasses import fields

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.health.stuck import StuckScreen
from fsw.messages import Samples
from tests.support.bus_traffic import cut
from tests.support.estimator_cases import make_config
from tests.support.samples import imu_samples, joint_samples, plain

MS = 1_000_000
CONFIG = make_config()


def part(samples: Samples, batch: slice) -> Samples:
    return type(samples)(**{f.name: getattr(samples, f.name)[batch] for f in fields(samples)})


def screened(samples: Samples, batches: list[slice]) -> tuple[list[object], list[str]]:
    screen = StuckScreen(CONFIG)
    out = [row for batch in batches for row in plain(screen.screen(part(samples, batch)))]
    return out, sorted(map(str, screen.take()))


def check(samples: Samples, rng: np.random.Generator) -> list[str]:
    count = len(samples)
    single = screened(samples, [slice(k, k + 1) for k in range(count)])
    for batches in ([slice(0, count)], cut(rng, count, 3.0), cut(rng, count, 50.0)):
        assert screened(samples, batches) == single
    return single[1]


def runs(rng: np.random.Generator, count: int, width: int) -> list[tuple[float, ...] | None]:
    """Return readings of which some repeat themselves in runs of any length, some unusable."""
    out: list[tuple[float, ...] | None] = []
    value: tuple[float, ...] = (0.0,) * width
    left = 0
    for _ in range(count):
        if left == 0:
            left = int(rng.choice([1, 2, 3, 4, 15, 80]))
            value = tuple(np.round(rng.normal(0.0, 0.1, width), 2).tolist())
        left -= 1
        out.append(None if rng.random() < 0.03 else value)
    return out


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_torques(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, joints = 120, len(CONFIG.joints)
    each = [runs(rng, count, 1) for _ in range(joints)]
    rows = []
    for k in range(count):
        for joint in rng.permutation(joints).tolist():
            reading = each[joint][k]
            torque = None if reading is None else reading[0]
            rows.append((2 * MS * k, 2 * MS * k + joint, joint, 0.1, torque))
    assert check(joint_samples(*rows), rng)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_rates_and_forces(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rates, forces = runs(rng, 400, 3), runs(rng, 400, 3)
    rows = [(2 * MS * k,) * 3 + (rates[k], forces[k]) for k in range(400)]
    assert check(imu_samples(*rows), rng)  # type: ignore[arg-type]
