"""Planned motions, from request to files, for `fsw excite`, `RUN_PLAN` and the Python API."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.errors import ConfigError
from fsw.estimators.model.inertia import from_parameters
from fsw.estimators.parameter_verdicts import in_words, predicted_verdicts
from fsw.messages import FloatArray
from planner import assess, criteria, export, firings, foreseen, spline
from planner.collision import Collisions, build_collisions
from planner.limits import MotionLimits
from planner.limits import load as load_limits
from planner.plan import Planner
from planner.request import MotionRequest
from planner.subject import QUANTITIES, Subject, build_subject
from planner.verify import Use

Report = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedMotion:
    """A motion that keeps every limit, with the criteria and sigmas that it promises."""

    trajectory: spline.Trajectory
    request: MotionRequest
    subject: Subject
    values: dict[str, float]  # criteria by name
    root: FloatArray  # R of the information R^T R of all states after the motion, with prior
    uses: list[Use]  # worst use of every limit, the largest excess first
    starts: tuple[str, ...]  # result of every start of the search, in words

    @property
    def joints(self) -> tuple[str, ...]:
        """Names (n,) of the joints, in the order of the URDF."""
        return tuple(self.subject.model.joint_names)

    @property
    def sigma(self) -> dict[str, float]:
        """Predicted 1 sigma by name of the reported quantity, `target.mass_kg` ..."""
        return dict(zip(self.subject.names, predicted_sigma(self.subject, self.root), strict=True))

    def bodies(self) -> dict[str, dict[str, Any]]:
        """Return nominal values and predicted sigmas of every body, in the layout of a result."""
        found: dict[str, dict[str, Any]] = {"estimate": {}, "sigma": {}}
        for body, k in self._places():
            mass, com, inertia = from_parameters(self.subject.x[k])
            found["estimate"][body] = _plain(np.concatenate(([mass], com, inertia)))
            found["sigma"][body] = _plain(np.array(predicted_sigma(self.subject, self.root))[k])
        return found

    def changes(self) -> list[str]:
        """Return a line for each body: every quantity's sigma before and after the motion."""
        before, after = self.subject.scale.prior_sigma, list(self.sigma.values())
        return [
            f"{body}: sigma "
            + ", ".join(
                f"{name} {was:.3g} > {will:.3g}"
                for name, was, will in zip(QUANTITIES, before[k], after[k], strict=True)
            )
            for body, k in self._places()
        ]

    def _places(self) -> list[tuple[str, slice]]:
        problem = self.subject.problem
        return [(body, problem.body(body)) for body in problem.unknown]

    def samples(self, rate_hz: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return times (m,) [s], positions, speeds, accelerations, each (m, n) [rad or m, s]."""
        t_s = export.sample_times(self.trajectory, rate_hz)
        q, qd, qdd, _ = self.trajectory.evaluate(t_s)
        return t_s, q, qd, qdd

    def save(self, out: Path | str, rate_hz: float = 20.0) -> None:
        """Write the spline (YAML), and beside it samples as CSV and as a ROS JointTrajectory."""
        out = Path(out)
        self.save_spline(out, "fsw excite")
        units = {"revolute": "rad", "prismatic": "m"}
        kinds = (units[kind] for kind in self.subject.model.kinds())
        named = dict(zip(self.joints, kinds, strict=True))
        export.write_csv(self.trajectory, named, out.with_suffix(".csv"), rate_hz)
        ros = out.with_name(f"{out.stem}_joint_trajectory.yaml")
        export.write_joint_trajectory(self.trajectory, self.joints, ros, rate_hz)

    def save_spline(self, out: Path, command: str) -> None:
        """Write the spline (YAML) with its predicted sigmas; replace an old file in one step."""
        before = dict(zip(self.subject.names, self.subject.scale.prior_sigma, strict=True))
        about: dict[str, Any] = {
            "command": command,
            "unknown": list(self.subject.problem.unknown),
            "criterion": self.request.criterion,
            "seed": self.request.seed,
            "values": {key: float(f"{value:.6g}") for key, value in self.values.items()},
            "joints": list(self.joints),
            "limits": {use.kind: float(f"{use.value:.5g}") for use in self.uses},
            "sigma_before_and_after": {
                name: [float(f"{before[name]:.4g}"), float(f"{after:.4g}")]
                for name, after in self.sigma.items()
            },
        }
        out.parent.mkdir(parents=True, exist_ok=True)
        partial = out.with_name(f".{out.name}")
        spline.save(self.trajectory, partial, about)
        partial.replace(out)


def bounds(
    config: Config, subject: Subject, path: Path, report: Report
) -> tuple[MotionLimits, Collisions | None]:
    """Return the limits of a file, and the collision pairs to check (None: nothing to check).

    Raises
    ------
    ConfigError when the limits are invalid.
    """
    limits, collisions = load_limits(path), None
    names = [mode.name for mode in config.modes]
    firings.check_names(path, "mode_amplitude", limits.mode_amplitude, names)
    firings.check(path, limits.firings, config)
    if limits.clearance_m is None:
        report("clearance_m is null: collisions are NOT checked; look at the motion with fsw view")
    else:
        urdf, tool = config.resolve(config.robot.urdf), config.robot.tool_frame
        collisions = build_collisions(subject.model, urdf, tool, limits.target_box)
        if collisions is None:
            report("no collision geometry in the URDF: clearance_m is not checked")
    return limits, collisions


def planned(
    subject: Subject,
    limits: MotionLimits,
    collisions: Collisions | None,
    request: MotionRequest,
    report: Report,
    guess: spline.Trajectory | None = None,
) -> PlannedMotion:
    """Plan a motion and predict its sigmas.

    Raises
    ------
    InfeasibleError when no motion is found that keeps the limits.
    """
    found = Planner(subject, limits, collisions, request, report).plan(guess)
    report("judging the motion")
    trajectory = replace(found.trajectory, firings=limits.firings)
    values, root = judged(subject, trajectory, request.rate_hz, request.gamma)
    return PlannedMotion(
        trajectory=trajectory,
        request=request,
        subject=subject,
        values=values,
        root=root,
        uses=found.uses,
        starts=found.starts,
    )


def judged(
    subject: Subject, trajectory: spline.Trajectory, rate_hz: float, gamma: criteria.Gamma
) -> tuple[dict[str, float], FloatArray]:
    """Return every criterion by name, and R: R^T R is the information after the motion.

    R is of all states of the configuration, the criteria `cond` and `gamma` of the bodies alone.
    """
    root = foreseen.foreseen_root(subject, trajectory)
    values = assess.all_criteria(subject, trajectory, rate_hz, gamma)
    return values | assess.fused_criteria(subject, root), root


def check_motion(config: Config, path: Path) -> list[str]:
    """Return the predicted sigmas of the unknown bodies after a motion from a file, in words.

    Raises
    ------
    ConfigError when the motion does not fit the robot.
    """
    subject, trajectory = build_subject(config), loaded(path, config)
    root = foreseen.foreseen_root(subject, trajectory)
    words = f"{path}: motion of {trajectory.duration_s:g} s; expected after it, by these sensors:"
    return [words, *knowledge(subject, root)]


def loaded(path: Path, config: Config) -> spline.Trajectory:
    """Read a trajectory.

    Raises
    ------
    ConfigError when the file is not a trajectory, or it is of another robot.
    """
    trajectory = spline.load(path)
    if trajectory.n != len(config.joints):
        raise ConfigError(f"{path}: has {trajectory.n} joints; the robot has {len(config.joints)}")
    firings.check(path, trajectory.firings, config)
    return trajectory


def knowledge(subject: Subject, root: FloatArray) -> list[str]:
    """Return lines: the sigma of every reported quantity, and a verdict on each body."""
    sigma, prior = np.array(predicted_sigma(subject, root)), subject.scale.prior_sigma
    lines = [
        f"{name}: predicted sigma {own:.4g} (prior {before:.4g})"
        for name, own, before in zip(subject.names, sigma, prior, strict=True)
    ]
    for body in subject.problem.unknown:
        k = subject.problem.body(body)
        mass_kg, _, inertia = from_parameters(subject.x[k])
        words = in_words(predicted_verdicts(mass_kg, inertia, sigma[k], prior[k]))
        lines.append(f"{body}: {words}; mass to {100.0 * sigma[k][0] / mass_kg:.2g} %")
    return lines


def _plain(values: FloatArray) -> dict[str, Any]:
    """Return ten reported quantities in the layout of a result."""
    mass, com, inertia = float(values[0]), values[1:4].tolist(), values[4:].tolist()
    return {"mass_kg": mass, "com_m": com, "inertia_kg_m2": inertia}


def predicted_sigma(subject: Subject, root: FloatArray) -> list[float]:
    """Return 1 sigma (p,) of the reported quantities for an information root."""
    sigma: list[float] = np.sqrt(np.diag(criteria.report_covariance(root, subject.scale))).tolist()
    return sigma
