"""Write the page of `fsw view`, which contains scene and viewer and loads no other file."""

import json
import re
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from file_delivery.extras import needs
from fsw.config import Config
from fsw.errors import ConfigError, EstimatorError
from fsw.estimators.conditioning.plausible import plausible
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.inertia import PARAMETERS, from_parameters
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.pipeline import default_pipeline
from fsw.estimators.publish import body_estimate
from fsw.estimators.recursive.online import OnlineEstimator
from offline.replay import replay
from offline.report.collect import Collector, Progress
from offline.view import scene
from offline.view.bodies import SIGMAS, Guess, com_covariance, guesses, parameters, read_truth
from offline.view.motion import Motion, planned, recorded
from offline.view.shapes import (
    BASE,
    BODY,
    Shape,
    box_of,
    capsules,
    frame_of,
    hull,
    reach_m,
    visuals,
)
from planner import spline

PLANS = (".yaml", ".yml")
SEE_THROUGH = 0.15


def view(source: Path, config: Config, out: Path, truth: Path | None, progress: Progress) -> Path:
    """Write the page of a recording (MCAP) or a plan (YAML of `fsw excite`); return its path.

    Parameters
    ----------
    truth : JSON file with the true bodies; None: they are not known

    Raises
    ------
    ConfigError if meshcat is missing or files do not fit; EstimatorError if no window is usable.
    """
    viewer = _viewer()
    true = {} if truth is None else read_truth(truth, config.unknown)
    if source.suffix in PLANS:
        problem, motion, known, verdict = _plan(source, config)
    else:
        problem, motion, known, verdict = _recording(source, config, progress)
    model = problem.model
    reach = reach_m(model, config.robot.tool_frame)
    places = {name: _frame(model, config, name) for name in ["base", *config.bodies]}
    centres = []
    for name, guess in known.items():
        frame, place = places[name]
        shown = scene.centre(scene.path_of(model, frame), name, place, guess, reach)
        centres.append(scene.with_truth(shown, place, true.get(name)))
    drawn = _visuals(model, config, progress)
    shapes = drawn or capsules(model, config.robot.tool_frame)
    for name, (frame, place) in places.items():
        if frame > 0 or all(shape.frame > 0 for shape in drawn):
            shapes.append(_box(name, config, problem, known, (frame, place)))
    values = {
        "frames": scene.frames(model, motion),
        "parts": scene.parts(model, shapes),
        "bodies": centres,
        "reach_m": reach,
        "duration_s": scene.numbers(motion.t_s)[-1],
    }
    title = f"{source.name}: {' and '.join(problem.unknown)}"
    return _write(out, title, verdict, _notes(motion, config), values, viewer)


def _recording(
    path: Path, config: Config, progress: Progress
) -> tuple[Problem, Motion, dict[str, list[Guess]], str]:
    sink, pipeline = Collector(), default_pipeline(config)
    progress(f"replaying {path}")
    result = replay(path, config, sink=sink, pipeline=pipeline, progress=progress)
    if result.truncated:
        progress(f"warning: {result.cut_off()}")
    blocks = [block for block in sink.blocks if plausible(block)]
    last, estimator = result.estimate, pipeline.estimator
    if last is None or not blocks or not isinstance(estimator, OnlineEstimator):
        raise EstimatorError(f"{path}: no window could be used, so there is no motion to show")
    problem = estimator.problem
    x = problem.prior_mean.copy()
    for name in problem.unknown:
        x[problem.body(name)] = parameters(last.bodies[name])
    motion = recorded(blocks, problem, problem.pi(x), result.start_ns)
    known = {name: guesses(sink.estimates, name, result.start_ns) for name in problem.unknown}
    return (
        problem,
        motion,
        known,
        "VALID" if last.valid else f"NOT VALID: {', '.join(last.reasons)}",
    )


def _plan(path: Path, config: Config) -> tuple[Problem, Motion, dict[str, list[Guess]], str]:
    config = config.model_copy(update={"wrench_sensors": ()})
    model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
    problem = build_problem(config, model, exact=True)
    trajectory = spline.load(path)
    if trajectory.n != model.n:
        raise ConfigError(f"{path}: moves {trajectory.n} joints; the robot has {model.n}")
    x, P = problem.prior_mean, problem.prior_covariance
    known = {
        name: [
            Guess(
                t_s=0.0,
                body=body_estimate(problem, name, x, P)[0],
                covariance_m2=com_covariance(x[own], P[own, own]),
            )
        ]
        for name in problem.unknown
        for own in [problem.body(name)]
    }
    return problem, planned(trajectory, problem, problem.pi(x)), known, "PLAN, bodies as configured"


def _frame(model: RobotModel, config: Config, name: str) -> tuple[int, pin.SE3]:
    """Return the link that carries a body (0: the base), and the pose of the body's frame there."""
    if name == "base":
        return 0, pin.SE3.Identity()
    return frame_of(model, config.bodies[name].frame or config.robot.tool_frame)


def _visuals(model: RobotModel, config: Config, progress: Progress) -> list[Shape]:
    try:
        return visuals(model, config.resolve(config.robot.urdf))
    except ConfigError as error:  # a recording carries the URDF without its meshes
        progress(f"{error}; links are drawn as capsules")
        return []


def _box(
    name: str,
    config: Config,
    problem: Problem,
    known: Mapping[str, Sequence[Guess]],
    where: tuple[int, pin.SE3],
) -> Shape:
    """Return the box with a body's mass and inertia, as last estimated or else as configured."""
    if name in known:
        body = known[name][-1].body
        corners = box_of(body.mass_kg, body.com_m, body.inertia_kg_m2)
    elif name in config.bodies:
        stated = config.bodies[name]
        corners = box_of(stated.mass_kg, np.array(stated.com_m), np.array(stated.inertia_kg_m2))
    else:
        corners = box_of(*from_parameters(problem.model.pi_links[:PARAMETERS]))
    (frame, place), (vertices, faces) = where, hull(corners)
    return Shape(
        frame=frame,
        vertices_m=vertices @ place.rotation.T + place.translation,
        faces=faces,
        colour=BODY if frame else BASE,
        opacity=SEE_THROUGH,
    )


def _notes(motion: Motion, config: Config) -> list[str]:
    where = {
        "free": "The centre of mass of everything rests at the origin, whose axes are 0.5 m long.",
        "planar": "Along the table, the centre of mass of everything rests.",
        "clamped": "The base is clamped.",
    }
    return [
        f"{where[config.base.motion]} Attitude: {motion.attitude}.",
        f"Ellipsoids hold the estimated centre of mass within {SIGMAS:g} sigma. One that is too "
        "small to see is drawn larger by the factor that stands beside it, and the distance of "
        "the truth from its centre too. Translucent boxes have the mass and inertia of their body.",
    ]


def _viewer() -> str:
    """Return the JavaScript viewer of the package meshcat, without importing the package."""
    found = find_spec("meshcat")
    if found is None or found.origin is None:
        raise ConfigError(needs("fsw view", "meshcat", "view"))
    folder = Path(found.origin).parent / "viewer"
    names = ("LICENSE", "dist/main.min.js.LICENSE.txt", "dist/main.min.js")
    licence, others, program = ((folder / name).read_text(encoding="utf-8") for name in names)
    return f"/*!\n{licence}*/\n{others}\n{program}"


def _write(
    out: Path, title: str, verdict: str, notes: Sequence[str], scene: Mapping[str, Any], viewer: str
) -> Path:
    own = files("offline.view")
    filled = {
        "title": escape(title),
        "verdict": escape(verdict),
        "notes": "".join(f"<p>{escape(note)}</p>" for note in notes),
        "scene": json.dumps(scene, allow_nan=False).replace("</", "<\\/"),
        "viewer": viewer,
        "script": own.joinpath("page.js").read_text(encoding="utf-8"),
    }
    text = own.joinpath("page.html").read_text(encoding="utf-8")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(re.sub(r"@(\w+)@", lambda m: filled[m[1]], text), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}") from error
    return out
