"""Windows hold the same samples however these are cut into batches."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fsw.config import Config
from fsw.messages import Samples
from fsw.scheduler.align import AlignCounters, Aligner
from tests.conftest import ArmProject
from tests.support.bus_traffic import cut
from tests.support.loop_cases import MS, arm_config
from tests.support.samples import attitude_samples, imu_samples, joint_samples

T0 = 1_000 * MS
WINDOW, LAG = 400 * MS, 150 * MS


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Config:
    return arm_config(ArmProject(tmp_path_factory.mktemp("align")))


def part(samples: Samples, batch: slice) -> Samples:
    return type(samples)(**{f.name: getattr(samples, f.name)[batch] for f in fields(samples)})


def aligned(
    config: Config, kinds: list[Samples], cuts: list[list[slice]]
) -> tuple[object, AlignCounters]:
    """Return the windows and counters; the kinds come one after the other."""
    aligner = Aligner(config, 3)
    for number, (samples, batches) in enumerate(zip(kinds, cuts, strict=True)):
        for batch in batches:
            aligner.push(part(samples, batch))
        if number == 0:
            aligner.start(T0)  # what came before is sorted in
    windows = aligner.close(T0 + 6 * WINDOW + LAG)
    shown = [
        [(c.t_ns.tolist(), str(c.values.tolist()), c.missing, c.stale) for c in channels]
        for w in windows
        for channels in ([*w.joints, w.gyro, w.accelerometer, w.attitude],)
    ]
    return shown, aligner.counters()


def times(rng: np.random.Generator, count: int, dense: bool) -> tuple[list[int], list[int]]:
    """Return times of validity and of receipt: early, late, absurd and out of order among them."""
    span = WINDOW if dense else 5 * WINDOW
    received_ns = np.sort(T0 - 20 * MS + rng.integers(0, span, count))
    t_ns = received_ns - rng.integers(0, 8 * MS, count)
    odd = rng.random(count)
    t_ns = np.where(odd < 0.05, t_ns - rng.integers(0, 2 * WINDOW, count), t_ns)
    t_ns = np.where(odd > 0.97, t_ns + rng.integers(0, 8 * WINDOW, count), t_ns)
    return t_ns.tolist(), received_ns.tolist()


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_windows_do_not_depend_on_batches(config: Config, seed: int, dense: bool) -> None:
    rng = np.random.default_rng(seed)
    count = 1500 if dense else 300
    t_ns, received_ns = times(rng, count, dense)
    owners = rng.integers(0, 3, count).tolist()
    torques = [None if rng.random() < 0.05 else float(k) for k in range(count)]
    joints = joint_samples(
        *zip(t_ns, received_ns, owners, [k * 1e-3 for k in range(count)], torques, strict=True)
    )
    t_ns, received_ns = times(rng, count, dense)
    vectors = [None if rng.random() < 0.1 else (float(k), 0.0, 1.0) for k in range(count)]
    acc_ns = [t - 4 * MS for t in t_ns]
    imu = imu_samples(*zip(t_ns, acc_ns, received_ns, vectors, vectors[::-1], strict=True))
    t_ns, received_ns = times(rng, 60, dense)
    q = [(0.0, 0.0, 0.0, 1.0)] * 60
    kinds: list[Samples] = [joints, imu, attitude_samples(*zip(t_ns, received_ns, q, strict=True))]
    whole = [[slice(0, len(samples))] for samples in kinds]
    single = aligned(config, kinds, [[slice(k, k + 1) for k in range(len(s))] for s in kinds])
    assert aligned(config, kinds, whole) == single
    assert aligned(config, kinds, [cut(rng, len(s), 20.0) for s in kinds]) == single
    _, counters = single
    assert counters.early
    assert counters.future
    assert counters.overflow if dense else any(counters.late.values())
