"""`hil differential`: the error of the target's mass with and without a reference run.

Both runs have the same motion; the reference run has no target. Links are wrong by 5 % (1 sigma),
joints have friction, and both are declared. The batch identifies the target without or with it.
"""

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from evidence import runner
from evidence.methods.cases import NODES, RATE_HZ, SENSOR_SETS, WINDOW_S, scenario_of, truth_of
from evidence.methods.exact import true_robot
from evidence.methods.flight_side import write_config
from evidence.methods.sensed import condition, declared, draws, sensed, with_biases, with_noise
from evidence.store import Row, Store
from fsw.config import Config
from fsw.config.robot import BodySigma
from fsw.estimators.batch.run import run_batch
from fsw.messages import Block
from hil.judge import chi_square
from hil.judge.score import normalised_error_squared
from hil.world.friction import JointFriction, draw_friction
from hil.world.history import TruthState
from hil.world.spline import JointSpline
from hil.world.truth import simulate

STREAM = 3000  # first seed of links, friction and noise
SAMPLES = 2400  # 24 s of the motion
FRICTION = {"friction_coulomb_sigma_nm": 0.3, "friction_viscous_sigma_nms_rad": 0.5}
LINKS_SIGMA = 0.05
SENSORS = SENSOR_SETS["data sheet"]
WAYS = ("plain", "reference")
HALF = 0.5  # largest allowed ratio of the errors with and without a reference
RESAMPLED = 10_000  # bootstrap samples for the interval of the ratio


def work(seed: int) -> dict[str, Row]:
    """Return the results of a seed with and without a reference, one row under the seed's text."""
    truth = truth_of("target")
    with tempfile.TemporaryDirectory(prefix="differential-") as name:
        config, loaded, empty = case(seed, Path(name))
        row: dict[str, Any] = {}
        for way, reference in zip(WAYS, ((), empty), strict=True):
            found = run_batch(config, loaded, "fused", (), reference=reference)
            own = slice(0, truth.size)
            error = np.array(found["mean"])[own] - truth
            covariance = np.array(found["covariance"])[own, own]
            row[way] = {
                "status": found["status"],
                "error_kg": float(error[0]),
                "sigma_kg": float(np.sqrt(covariance[0, 0])),
                "nees": normalised_error_squared(error, covariance),
            }
        return {str(seed): row}


def case(seed: int, folder: Path) -> tuple[Config, list[Block], list[Block]]:
    """Return the configuration, the blocks with the target, and the blocks without the target."""
    rng = np.random.default_rng(STREAM + seed)
    right = write_config(scenario_of("target"), seed, folder)
    config = _uncertain(right, folder, rng)
    friction = draw_friction(
        rng, len(right.joints), coulomb_sigma_nm=0.3, viscous_sigma_nms_rad=0.5
    )
    loaded, empty = (_recorded(right, config, friction, rng, loaded=k) for k in (True, False))
    return config, loaded, empty


@lru_cache(maxsize=2)
def _motion(*, loaded: bool) -> TruthState:
    """Return the true states of the identification motion, with or without the target."""
    scenario = scenario_of("target")
    known = {name: r for name, r in scenario.truth.items() if loaded or name != "target"}
    robot = true_robot(replace(scenario, truth=known))
    times = np.arange(SAMPLES) / RATE_HZ
    spline = JointSpline.load(scenario.identification)
    return simulate(robot, spline, 0.0, times[-1] + 0.1, 0.5 / RATE_HZ).at(times)


def _uncertain(right: Config, folder: Path, rng: np.random.Generator) -> Config:
    """Return a configuration with wrong link masses and inertias, and sigmas that declare it."""
    path = right.resolve(right.robot.urdf)
    root = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    children = {child.get("link") for child in root.iter("child")}
    for link in root.iter("link"):
        factor = 1.0 + LINKS_SIGMA * rng.standard_normal()
        if link.get("name") in children:
            for element in (*link.iter("mass"), *link.iter("inertia")):
                for key, value in element.attrib.items():
                    element.set(key, repr(factor * float(value)))
    wrong = folder / "wrong.urdf"
    wrong.write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
    joints = [joint.model_copy(update=FRICTION) for joint in right.joints]
    robot = right.robot.model_copy(update={"urdf": wrong, "links_sigma_ratio": LINKS_SIGMA})
    base = right.bodies["base"]  # it was weighed before the flight, so its sigma is small
    weighed = BodySigma(mass_kg=1e-4 * base.mass_kg, com_m=(1e-5,) * 3, inertia_kg_m2=(1e-2,) * 6)
    bodies = {**right.bodies, "base": base.model_copy(update={"sigma": weighed})}
    config = right.model_copy(update={"joints": joints, "robot": robot, "bodies": bodies})
    return declared(config, SENSORS, RATE_HZ, window_s=WINDOW_S, nodes=NODES)


def _recorded(
    right: Config,
    config: Config,
    friction: JointFriction,
    rng: np.random.Generator,
    *,
    loaded: bool,
) -> list[Block]:
    """Return the blocks of one run; noise, torque offsets and biases are drawn for this run."""
    state = _motion(loaded=loaded)
    n = state.q.shape[1]
    noisy = with_noise(sensed(state, right), SENSORS, draws(SAMPLES, n, rng, shared=False))
    rubbed = replace(noisy, tau_nm=noisy.tau_nm + friction.torque_nm(state.qd))
    return condition(with_biases(rubbed, right, rng), config, RATE_HZ)


def differential(seeds: Sequence[int], jobs: int, out: Path | None) -> dict[str, Any]:
    """Run the seeds that the folder lacks; return the summary of all seeds.

    Raises
    ------
    ScenarioError if the folder holds results of another study.
    """
    store = Store(out, {"differential": "5 % of the links, friction"})
    return summary(runner.rows("differential", work, seeds, store, jobs))


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the errors of the mass, their ratio with its 95 % interval, and the mean NEES.

    The interval is a bootstrap over the seeds; both results of a seed are drawn together.
    """
    errors, sigmas, nees = (
        np.array([[row[way][key] for way in WAYS] for row in rows])
        for key in ("error_kg", "sigma_kg", "nees")
    )
    count = len(rows)
    again = np.random.default_rng(0).integers(count, size=(RESAMPLED, count))
    square = np.mean(errors[again] ** 2, axis=1)
    rms = np.sqrt(np.mean(errors**2, axis=0))
    ratio = float(rms[1] / rms[0])
    low, high = chi_square.mean_ends(10, count, 0.01)
    means = nees.mean(axis=0)
    fine = all(row[way]["status"] == "OK" for row in rows for way in WAYS)
    return {
        "seeds": count,
        "rms_error_kg": dict(zip(WAYS, rms.tolist(), strict=True)),
        "sigma_kg": dict(zip(WAYS, np.sqrt(np.mean(sigmas**2, axis=0)).tolist(), strict=True)),
        "ratio": ratio,
        "ratio_95": np.quantile(np.sqrt(square[:, 1] / square[:, 0]), (0.025, 0.975)).tolist(),
        "mean_nees": dict(zip(WAYS, means.tolist(), strict=True)),
        "band_99": [low, high],
        "passed": bool(fine and ratio <= HALF and np.all((low <= means) & (means <= high))),
    }


def lines(found: Mapping[str, Any]) -> str:
    """Return the summary as lines of text for the terminal."""
    low, high = found["band_99"]
    text = [
        f"{way}: error of the mass {found['rms_error_kg'][way]:.3g} kg rms, sigma "
        f"{found['sigma_kg'][way]:.3g} kg, mean NEES {found['mean_nees'][way]:.2f} for 10, "
        f"99 % band [{low:.2f}, {high:.2f}]"
        for way in WAYS
    ]
    least, most = found["ratio_95"]
    verdict = "ok" if found["passed"] else "FAILED"
    text.append(
        f"error with over without a reference {found['ratio']:.3f}, 95 % interval [{least:.3f}, "
        f"{most:.3f}], {found['seeds']} seeds; at most {HALF}: {verdict}"
    )
    return "\n".join(text)


def run(*, first: int, count: int, jobs: int, out: Path | None, as_json: bool) -> int:
    """Print the summary; return the exit code, 0 if the error is halved."""
    found = differential(range(first, first + count), jobs, out)
    print(json.dumps(found) if as_json else lines(found))
    return 0 if found["passed"] else 1
