"""Choose exciting joint trajectories inside every limit: `python -m hil.shrink`.

Random start poses and control points are shrunk until the first limit is nearly touched, the best
are improved by random changes of control points, and the result is shrunk once more in the truth.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.excitation import Probe, Subject, probe, subject
from hil.world.limits import LimitCheck, Limits, check, worst
from hil.world.robot import Robot, load_bodies
from hil.world.spline import REST_POINTS, JointSpline
from hil.world.truth import simulate

FloatArray = NDArray[np.float64]

ROBOTS = Path(__file__).parent / "robots"
URDF = ROBOTS / "lbr3_satellite.urdf"
SYSTEMS: dict[str, tuple[str | None, tuple[str, ...]]] = {
    "base": (None, ("base",)),
    "target_leo": ("target_leo", ("base", "target")),
    "target_geo": ("target_geo", ("base", "target")),
}
SHARE = 0.97  # of the first limit that is touched
TOLERANCE = 0.005
DURATION_S = 60.0
POINTS = 21  # knots every 3.75 s
START_RANGE = 0.6  # share of a joint's range for start poses


def main(arguments: list[str] | None = None) -> int:
    """Search, confirm in the truth, write the file, print what limits it."""
    parser = argparse.ArgumentParser(prog="python -m hil.shrink", description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("--system", choices=sorted(SYSTEMS), required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--candidates", type=int, default=300)
    parser.add_argument("--changes", type=int, default=1500)
    options = parser.parse_args(arguments)
    body, unknown = SYSTEMS[options.system]
    target = None if body is None else load_bodies(ROBOTS / "bodies.yaml")[body]
    light = subject(URDF, "tool", target, unknown)
    found, information = search(light, options.seed, options.candidates, options.changes)
    spline, checks = confirm(Robot.load(URDF, "tool", target=target), found)
    name, first = worst(checks)
    about = {
        "command": (
            f"python -m hil.shrink {options.output.as_posix()} --system {options.system} "
            f"--seed {options.seed} --candidates {options.candidates} --changes {options.changes}"
        ),
        "robot": URDF.name,
        "system": options.system,
        "seed": options.seed,
        "information_nats": round(information, 3),
        "first_limit": name,
        "largest_values": {key: float(f"{entry.value:.5g}") for key, entry in checks.items()},
    }
    spline.save(options.output, about)
    sys.stdout.write(f"{options.output}: {information:.2f} nats, {name} at {first.ratio:.3f}\n")
    return 0


def search(robot: Subject, seed: int, candidates: int, changes: int) -> tuple[JointSpline, float]:
    """Best of `candidates` random motions, then `changes` random improvements of it.

    Returns
    -------
    the motion and the information (log-determinant) it gives about the unknown bodies
    """
    rng = np.random.default_rng(seed)
    limits = Limits()
    best: JointSpline | None = None
    score = -np.inf
    for _ in range(candidates):
        spline, seen = fit(robot, _random(robot, rng), limits)
        if seen.ratio <= SHARE and seen.information_nats > score:
            best, score = spline, seen.information_nats
    if best is None:
        raise ValueError(f"none of {candidates} candidates keeps the limits (seed {seed})")
    size = 0.3
    for _ in range(changes):
        spline, seen = fit(robot, _changed(best, size, rng), limits)
        if seen.ratio <= SHARE and seen.information_nats > score:
            best, score = spline, seen.information_nats
            size = min(0.5, size * 1.3)
        else:
            size = max(0.02, size * 0.98)
    return best, score


def fit(robot: Subject, spline: JointSpline, limits: Limits) -> tuple[JointSpline, Probe]:
    """Shrink each joint to its own speed and acceleration limit, then all until none is broken."""
    _, qd, qdd = spline.evaluate(np.linspace(0.0, spline.duration_s, 601))
    speed = np.abs(qd).max(axis=0) / limits.joint_speed_rad_s
    acceleration = np.abs(qdd).max(axis=0) / limits.joint_acceleration_rad_s2
    factors = np.minimum(1.0, 0.999 * SHARE / np.maximum(speed, acceleration))
    points = spline.control_points_rad
    spline = JointSpline(spline.duration_s, points[0] + factors * (points - points[0]))
    seen = probe(robot, spline, limits)
    for _ in range(5):
        if seen.ratio <= SHARE:
            break
        factor = 0.999 * SHARE / seen.ratio if np.isfinite(seen.ratio) else 0.7
        spline = spline.scaled(max(0.5, factor))
        seen = probe(robot, spline, limits)
    return spline, seen


def confirm(robot: Robot, spline: JointSpline) -> tuple[JointSpline, dict[str, LimitCheck]]:
    """Scale a motion in the truth until the first limit stands at SHARE within TOLERANCE.

    Raises
    ------
    ValueError if scaling about the start pose cannot do that.
    """
    low, high, factor = 0.0, np.inf, 1.0
    for _ in range(20):
        scaled = spline.scaled(factor)
        checks = check(robot, simulate(robot, scaled, 0.0, scaled.duration_s, 0.01))
        _, first = worst(checks)
        if abs(first.ratio - SHARE) <= TOLERANCE:
            return scaled, checks
        if first.ratio > SHARE:
            high = factor
        else:
            low = factor
        step = factor * SHARE / max(first.ratio, 0.5)
        factor = step if low < step < high else 0.5 * (low + high)
    raise ValueError(f"no scale brings the first limit to {SHARE}; last was {first}")


def _random(robot: Subject, rng: np.random.Generator) -> JointSpline:
    """Random start pose, then control points around it wider than the limits allow."""
    centre = 0.5 * (robot.upper_rad + robot.lower_rad)
    half = 0.5 * (robot.upper_rad - robot.lower_rad)
    start = centre + START_RANGE * half * rng.uniform(-1.0, 1.0, len(centre))
    points = np.tile(start, (POINTS, 1))
    free = slice(REST_POINTS, POINTS - REST_POINTS + 1)
    points[free] += rng.uniform(-1.0, 1.0, points[free].shape)
    points[-REST_POINTS:] = points[-REST_POINTS]
    return JointSpline(DURATION_S, points)


def _changed(spline: JointSpline, size_rad: float, rng: np.random.Generator) -> JointSpline:
    """Move some control points, or the whole start pose; all a little wider first."""
    points = spline.scaled(1.05).control_points_rad.copy()
    if rng.random() < 0.2:
        points += size_rad * rng.normal(size=points.shape[1])
    free = slice(REST_POINTS, POINTS - REST_POINTS + 1)
    chosen = rng.random(points[free].shape) < rng.uniform(0.02, 0.4)
    points[free] += size_rad * rng.normal(size=points[free].shape) * chosen
    points[-REST_POINTS:] = points[-REST_POINTS]
    return JointSpline(spline.duration_s, points)


if __name__ == "__main__":
    sys.exit(main())
