"""One mistake on one motion: a wrong configuration reads the raw samples of a correct robot.

The samples are the readings of the devices: of joint nodes, and of the inertial unit in frame S.
So a wrong sign, zero, gain, mounting or delay acts as in flight. Conditioner and recursive
estimator of the flight software process the samples; every estimate is compared with the truth.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from evidence.methods.cases import NODES, RATE_HZ, SENSOR_SETS, WINDOW_S, scenario_of
from evidence.methods.exact import exact_samples
from evidence.methods.flight_side import write_config
from evidence.methods.sensed import (
    ChannelNoise,
    Channels,
    condition,
    declared,
    draws,
    faded,
    sensed,
    with_biases,
    with_noise,
)
from evidence.mistakes.readings import Readings, read, sent
from evidence.mistakes.recording import CONFIG, RECORDING, Recorded, judged
from evidence.mistakes.table import Mistake, mistakes, wrong
from fsw.config import Config, load
from fsw.errors import FswError
from fsw.estimators.batch.run import run_batch
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.recursive.online import build_online
from fsw.exchange.sinks import Message, NullSink
from fsw.messages import Block, Estimate
from hil.judge.outcome import CONFIDENT, worst
from hil.world.inertia import FloatArray
from offline.replay import replay

STREAM = 127  # spawn key of the samples' noise and biases
SENSORS = "data sheet"
NONE_Z = float("inf")  # of a result that was not made
DOUBTS = (
    *("links_sigma_ratio", "torque_scale_sigma_ratio", "zero_sigma_rad"),
    *("mounting_position_sigma_m", "mounting_angle_sigma_rad"),
)  # keys that declare the uncertainty of arm and calibration


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """The result of a mistake."""

    case: str = ""
    mistake: str = ""
    seed: int = 0
    refused: str = ""  # why the configuration was refused; empty if it was accepted
    valid: bool = False  # of the last estimate
    reason: str = ""  # why the last estimate is not valid
    z: float = NONE_Z  # largest |error| over sigma of the bodies' parameters in the last estimate
    mass_z: float = NONE_Z  # largest |error| over sigma of the masses in the last estimate
    mass_sigma: float = NONE_Z  # sigma of the mass over the mass, of the first unknown body
    outputs: int = 0  # valid estimates
    wrong: int = 0  # valid estimates with z above CONFIDENT
    beyond: int = 0  # wrong estimates whose correlation of innovations is beyond its bound
    events: tuple[str, ...] = ()  # codes in the order of the events
    batch: str = ""  # status of the batch; FAILED if it raised an error
    batch_z: float = NONE_Z  # z of the batch
    batch_note: str = ""
    recorded: str = ""  # status of `fsw identify` on a recording of the readings; empty: none made
    recorded_z: float = NONE_Z  # z of that result
    named: bool = False  # whether `fsw check` or `fsw import` names the mistake, or its refusal
    findings: tuple[str, ...] = ()  # what they say does not fit
    passed: bool = False  # whether `fsw identify --holdout` says so of the recording

    @property
    def passed_though_wrong(self) -> bool:
        """Whether identify says passed where check says WRONG."""
        return self.passed and any("WRONG" in line for line in self.findings)

    @property
    def confidently_wrong(self) -> bool:
        """Whether any recursive estimate, the batch or the recording's was valid and wrong."""
        batches = ((self.batch, self.batch_z), (self.recorded, self.recorded_z))
        return self.wrong > 0 or any(own == "OK" and z > CONFIDENT for own, z in batches)

    @property
    def harmless(self) -> bool:
        """Whether everything is valid and right, so that nothing need be named."""
        valid = self.valid and self.batch == "OK" and self.recorded in ("", "OK")
        return valid and not self.confidently_wrong


def run(
    case: str,
    mistake: str,
    seed: int,
    blocks: int = 100,
    *,
    exact: bool = False,
    recording: bool = False,
) -> Finding:
    """Return the result of a mistake, from at most `blocks` windows.

    `recording`: also import, check and identify a log of the readings.

    `exact`: the configuration declares arm and calibration as exactly known; otherwise their
    uncertainties have the default values.
    """
    with tempfile.TemporaryDirectory(prefix="mistake-") as name:
        folder = Path(name)
        right = write_config(scenario_of(case), seed, folder)
        document = yaml.safe_load((folder / "flight.yaml").read_text(encoding="utf-8"))
        document, urdf = wrong(mistake, document, (folder / "robot.urdf").read_text("utf-8"))
        if not exact:
            leave_to_the_defaults(document)
        (folder / "robot.urdf").write_text(urdf, encoding="utf-8")
        (folder / "wrong.yaml").write_text(yaml.safe_dump(document), encoding="utf-8")
        try:
            used = load(folder / "wrong.yaml")
            found = _judge(case, right, used, seed, blocks, mistake, folder, recording=recording)
        except FswError as error:
            found = Finding(refused=str(error).splitlines()[0], named=True)
        return replace(found, case=case, mistake=mistake, seed=seed)


def leave_to_the_defaults(document: dict[str, Any]) -> None:
    """Remove the keys that declare the uncertainty of arm and calibration from a configuration."""
    for section in (document["robot"], document["imu"], *document["joints"]):
        for key in DOUBTS:
            section.pop(key, None)


def _judge(
    case: str,
    right: Config,
    used: Config,
    seed: int,
    count: int,
    mistake: str,
    folder: Path,
    *,
    recording: bool,
) -> Finding:
    noise = SENSOR_SETS[SENSORS]
    scale = used.joints[0].torque_noise_nm / right.joints[0].torque_noise_nm
    told = replace(
        noise,
        position_rad=scale * noise.position_rad,
        torque_nm=scale * noise.torque_nm,
        rate_rad_s=scale * noise.rate_rad_s,
        acceleration_m_s2=scale * noise.acceleration_m_s2,
    )
    is_set = used.estimator.window_s != right.estimator.window_s
    window_s = used.estimator.window_s if is_set else WINDOW_S
    config = declared(used, told, RATE_HZ, window_s=window_s, nodes=NODES)
    channels, truth = samples(case, right, seed), scenario_of(case).truth
    devices = mistakes()[mistake].readings(sent(channels, right))
    if mistakes()[mistake].wired is not None:
        same_span = devices.first(round(count * window_s * RATE_HZ))
        return judged_on_wire(same_span, mistakes()[mistake], right, config, truth, folder)
    made = condition(read(devices, channels, right, config), config, RATE_HZ)[:count]
    online = build_online(
        config, RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
    )
    outputs = wrong = beyond = 0
    for block in made:
        estimate = online.push(block)
        if estimate.valid:
            outputs += 1
            if worst(estimate.bodies, truth) > CONFIDENT:
                wrong += 1
                lag, bound = (estimate.extra[k] for k in ("innovation_lag1", LAG_BOUND))
                beyond += lag > bound
    final, batch = online.finish(), _batch(config, made)
    found = _found(final, truth, outputs, wrong, beyond, online.events(), batch)
    if not recording:
        return found
    same_span = devices.first(round(count * window_s * RATE_HZ))
    return _with_recording(found, mistake, truth, same_span, right, config, folder)


def _with_recording(
    found: Finding,
    mistake: str,
    truth: Mapping[str, FloatArray],
    devices: Readings,
    right: Config,
    used: Config,
    folder: Path,
) -> Finding:
    return _recorded(found, judged(devices, right, used, folder), mistakes()[mistake], truth)


def _recorded(
    found: Finding, own: Recorded, mistake: Mistake, truth: Mapping[str, FloatArray]
) -> Finding:
    """Return a finding with what import, check and identify say of the recording."""
    return replace(
        found,
        recorded=own.status,
        recorded_z=_batch_worst(own.values, truth) if own.values else NONE_Z,
        named=any(word in line for word in mistake.words for line in own.findings),
        findings=own.findings,
        passed=own.passed,
    )


class _Estimates(NullSink):
    """Keeps the estimates of a replay."""

    def __init__(self) -> None:
        self.found: list[Estimate] = []

    def put(self, message: Message) -> None:
        """Keep an estimate; discard every other message."""
        if isinstance(message, Estimate):
            self.found.append(message)


def judged_on_wire(
    devices: Readings,
    mistake: Mistake,
    right: Config,
    used: Config,
    truth: Mapping[str, FloatArray],
    folder: Path,
) -> Finding:
    """Return the result of a mistake in the description of joints, from a recording of frames."""
    own = judged(devices, right, used, folder, mistake.wired)
    if not (folder / RECORDING).exists():
        return replace(_recorded(Finding(), own, mistake, truth), refused=own.findings[0])
    kept, config = _Estimates(), load(folder / CONFIG)
    result = replay(folder / RECORDING, config, sink=kept)
    found, batch = Finding(), own.values or None
    if result.estimate is not None:
        valid = [one for one in kept.found if one.valid]
        wrong = sum(worst(one.bodies, truth) > CONFIDENT for one in valid)
        events = [(event.severity, event.code, event.text) for event in result.events]
        found = _found(result.estimate, truth, len(valid), wrong, 0, events, batch)
    return _recorded(found, own, mistake, truth)


LAG_BOUND = "innovation_lag1_bound"


def _found(
    final: Estimate,
    truth: Mapping[str, FloatArray],
    outputs: int,
    wrong: int,
    beyond: int,
    events: list[tuple[str, str, str]],
    batch: Mapping[str, Any] | None,
) -> Finding:
    z, first = worst(final.bodies, truth), next(iter(final.bodies.values()))
    return Finding(
        valid=final.valid,
        reason=final.reason,
        z=z,
        mass_z=max(
            abs(b.mass_kg - truth[name][0]) / b.mass_sigma_kg for name, b in final.bodies.items()
        ),
        mass_sigma=first.mass_sigma_kg / first.mass_kg,
        outputs=outputs + final.valid,
        wrong=wrong + (final.valid and z > CONFIDENT),
        beyond=beyond,
        events=tuple(code for _, code, _ in events),
        batch="FAILED" if batch is None else str(batch["status"]),
        batch_z=NONE_Z if batch is None else _batch_worst(batch, truth),
        batch_note="" if batch is None else str(batch["note"]),
    )


def _batch(config: Config, blocks: list[Block]) -> dict[str, Any] | None:
    try:
        return run_batch(config, blocks, "fused", ())
    except FswError:
        return None


def samples(
    case: str,
    right: Config,
    seed: int,
    noise: ChannelNoise = SENSOR_SETS[SENSORS],
    torque_fading: float = 0.0,
) -> Channels:
    """Return the samples of a seed, of sensors as the right configuration describes them.

    Biases are drawn from the sigmas of this configuration. `torque_fading` is the correlation of
    the torque noise from one sample to the next.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM,)))
    state = exact_samples(case)
    unit = draws(len(state.q), state.q.shape[1], rng, shared=False)
    if torque_fading:
        unit["torque"] = faded(unit["torque"], torque_fading)
    return with_biases(with_noise(sensed(state, right), noise, unit), right, rng)


def _batch_worst(batch: Mapping[str, Any], truth: Mapping[str, FloatArray]) -> float:
    largest = 0.0
    for name, mean in batch["estimate"].items():
        sigma = batch["sigma"][name]
        rows = [np.concatenate([np.atleast_1d(v) for v in own.values()]) for own in (mean, sigma)]
        largest = max(largest, float(np.max(np.abs(rows[0] - truth[name]) / rows[1])))
    return largest
