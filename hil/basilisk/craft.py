"""Convert a scenario to a job for Basilisk, and Basilisk's result to a truth of the bench.

The engine gets rigid parts, torques, gains and the initial state, and computes all dynamics itself.
`hil.world.inertia` merges links that do not move.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hil.world.history import TruthHistory, slope
from hil.world.inertia import FloatArray, frame_map, pi_of, report_of, symmetric
from hil.world.links import Body, Link, body_of, link_of, read_links, with_base
from hil.world.robot import Robot, without
from hil.world.scenario import Scenario, ScenarioError
from hil.world.springs import Panel, SloshMass, Sprung

STEP_S = 1e-3
WITHIN = 4  # samples of a thruster's force within a step
HOLD_PERIOD_S = 0.01
HOLD_RAD_S = 10.0  # bandwidth of the springs that hold the arm to its plan; step: 1e-3 s


def on_lines(scenario: Scenario) -> Scenario:
    """Return the scenario with one sloshing mass per axis, where a tank has one mass on all axes.

    The engine's mass moves along one line. To first order in the displacement the forces are the
    same. The mass of base and liquid together does not change.
    """
    lines = [replace(part, axes=(axis,)) for part in scenario.slosh for axis in part.axes]
    return replace(scenario, slosh=tuple(lines))


def job_of(
    scenario: Scenario, robot: Robot, plan: TruthHistory, step_s: float = STEP_S
) -> dict[str, Any]:
    """Return the engine's input: the craft `about` (JSON) and arrays with one row per step.

    `q_rad`, `qd_rad_s` (k, n) at the step's start, `tau_nm` (k, n) its mean torque; `motor_nm`
    (k, w) torques of the wheels; `wrench` (k, 6) mean force and moment of the thrusters in B.
    `hold` (h, n, 2 n): gains of the springs that hold the arm to its plan, every HOLD_PERIOD_S.

    Parameters
    ----------
    plan : truth whose joint and motor torques drive the craft; its start is the craft's start

    Raises
    ------
    ScenarioError for an effect or a joint that this engine does not simulate.
    """
    for key in ("environment", "stand"):
        if getattr(scenario, key) is not None:
            raise ScenarioError(
                f"{scenario.name}: {key}: the second simulator has neither environment nor stand"
            )
    base = body_of(scenario.truth["base"])
    hub, chains = _craft(scenario, without(base, (*scenario.slosh, *scenario.panels)), plan.q[0])
    rotors = () if scenario.wheels is None else scenario.wheels.rotors
    about = {
        "dt_s": step_s,
        "hold_steps": round(HOLD_PERIOD_S / step_s),
        "hub": _named(hub),
        "chains": chains,
        "wheels": [
            {
                "mass_kg": rotor.mass_kg,
                "place_m": rotor.place_m,
                "axis": rotor.unit.tolist(),
                "inertia_kg_m2": rotor.inertia_kg_m2,
                "speed_rad_s": rotor.speed_rad_s,
            }
            for rotor in rotors
        ],
        "slides": [_slide(line) for line in scenario.slosh],
        "panels": [_hinge(panel) for panel in scenario.panels],
        "sigma_BN": Rotation.from_quat(plan.quat_wxyz[0, [1, 2, 3, 0]]).as_mrp().tolist(),
        "w_NB_B_rad_s": list(scenario.start_rate_rad_s),
    }
    steps = int((plan.end_s - plan.start_s) / step_s + 1e-6)
    middles = np.asarray(plan.start_s + step_s * (np.arange(steps) + 0.5), np.float64)
    pair: FloatArray = middles + step_s / np.sqrt(12.0) * np.array(
        [[-1.0], [1.0]]
    )  # two Gauss points: their mean is the mean over the step
    motor = np.zeros((steps, 0))
    if rotors:
        motor = np.array([plan.wheels_at(t)[1] for t in middles])
    starts = plan.at(middles - 0.5 * step_s)
    return {
        "about": json.dumps(about),
        "q_rad": starts.q,
        "qd_rad_s": starts.qd,
        "tau_nm": plan.at(pair).tau.mean(axis=0),
        "hold": _hold(robot, plan.at(np.arange(plan.start_s, plan.end_s, HOLD_PERIOD_S)).q),
        "motor_nm": motor,
        "wrench": _thrust(scenario, middles, step_s),
    }


def truth_of(job: Mapping[str, Any], flown: Mapping[str, Any], start_s: float) -> TruthHistory:
    """Return the engine's motion; torques and accelerations at the nodes are of fourth order."""
    about = json.loads(str(job["about"]))
    h, n, w = about["dt_s"], job["tau_nm"].shape[1], job["motor_nm"].shape[1]
    state = np.asarray(flown["state"])
    p_N, v_N, sigma, w_B = np.split(state[:, :12], 4, axis=1)
    q: list[FloatArray] = []
    qd: list[FloatArray] = []
    place = 12
    for chain in about["chains"]:
        for part in (q, qd):
            part.append(state[:, place : place + len(chain)])
            place += len(chain)
    angles, rates = np.hstack(q), np.hstack(qd)
    if angles.shape[1] != n:
        raise ValueError(f"the engine flew {angles.shape[1]} joints of {n}")
    speeds = state[:, state.shape[1] - w :]
    return TruthHistory(
        start_s=start_s,
        dt_s=h,
        q=angles,
        qd=rates,
        qdd=slope(rates, h),
        tau=_at_nodes(flown["tau_nm"], h),
        p_N=p_N - p_N[0],
        v_N=v_N,
        a_N=slope(v_N, h),
        quat_wxyz=_quaternions(sigma),
        w_B=w_B,
        wd_B=slope(w_B, h),
        wheel_rad_s=speeds if w else None,
        wheel_rad_s2=slope(speeds, h) if w else None,
        motor_nm=_at_nodes(job["motor_nm"], h) if w else None,
    )


def _thrust(scenario: Scenario, middles: FloatArray, step_s: float) -> FloatArray:
    """Return the thrusters' mean force and moment of every step (k, 6) in B [N, N m]."""
    if scenario.thrusters is None:
        return np.zeros((len(middles), 6))
    parts = step_s * ((np.arange(WITHIN) + 0.5) / WITHIN - 0.5)
    wrench = scenario.thrusters.wrench
    return np.array([np.mean([wrench(t + part) for part in parts], axis=0) for t in middles])


def _hold(robot: Robot, q_rad: FloatArray) -> FloatArray:
    """Return gains (k, n, 2 n) on angle and rate errors, from the arm's inertia on a free base."""
    data, passive = mujoco.MjData(robot.model), robot.model.nv - robot.n
    H = np.empty((robot.model.nv, robot.model.nv))
    gains = np.empty((len(q_rad), robot.n, 2 * robot.n))
    for k, q in enumerate(q_rad):
        data.qpos[-robot.n :] = q
        mujoco.mj_fwdPosition(robot.model, data)
        mujoco.mj_fullM(robot.model, data, H)
        given = np.linalg.solve(H[:passive, :passive], H[:passive, passive:])
        inertia = H[passive:, passive:] - H[passive:, :passive] @ given
        gains[k] = np.hstack([HOLD_RAD_S**2 * inertia, 2.0 * HOLD_RAD_S * inertia])
    return gains


def _at_nodes(held: FloatArray, h: float) -> FloatArray:
    """Return values at the nodes (k + 1, m) of a quantity that is constant over each of k steps."""
    impulse = np.vstack([np.zeros((1, held.shape[1])), np.cumsum(h * held, axis=0)])
    return slope(impulse, h)


def _quaternions(sigma: FloatArray) -> FloatArray:
    """Return continuous quaternions (k, 4), scalar first, of modified Rodrigues vectors (k, 3)."""
    wxyz = Rotation.from_mrp(sigma).as_quat()[:, [3, 0, 1, 2]]
    turned = np.cumprod(np.sign(np.einsum("ij,ij->i", wxyz[1:], wxyz[:-1])))
    return np.asarray(wxyz * np.concatenate([[1.0], turned])[:, None])


def _craft(
    scenario: Scenario, base: Body, q_rad: FloatArray
) -> tuple[FloatArray, list[list[dict[str, Any]]]]:
    """Return the hub's pi (10,) and the chains of moving links; fixed parts are merged in."""
    links = with_base(read_links(scenario.urdf), base)
    held = {scenario.tool_frame: scenario.truth.get("target")}
    held |= {frame: scenario.truth[name] for name, frame in scenario.frames.items()}
    place: dict[str, tuple[str, FloatArray, FloatArray]] = {}  # link L: carrier C, R_CL, p_CL
    pi: dict[str, FloatArray] = {}
    moving: list[Link] = []
    for link in links:
        R_PL = Rotation.from_quat(link.q_PL_xyzw).as_matrix()
        p_PL = np.array(link.p_PL_P_m)
        if link.parent is None or link.axis is not None:
            place[link.name] = link.name, np.eye(3), np.zeros(3)
            pi[link.name] = np.zeros(10)
            if link.is_prismatic:
                raise ScenarioError(
                    f"{scenario.name}: {link.joint!r} is prismatic; it is not flown"
                )
            if link.axis is not None:
                moving.append(link)
        else:
            carrier, R, p = place[link.parent]
            place[link.name] = carrier, R @ R_PL, p + R @ p_PL
        if link.body is not None:
            _add(pi, place[link.name], _report(link.body))
    for frame, report in held.items():
        if report is not None:
            _add(pi, place[link_of(scenario.urdf, links, frame).name], report)
    return pi[links[0].name], _chains(scenario, moving, place, pi, q_rad)


def _add(
    pi: dict[str, FloatArray], place: tuple[str, FloatArray, FloatArray], report: FloatArray
) -> None:
    carrier, R, p = place
    pi[carrier] = pi[carrier] + frame_map(R, p) @ pi_of(report)


def _chains(
    scenario: Scenario,
    moving: list[Link],
    place: Mapping[str, tuple[str, FloatArray, FloatArray]],
    pi: Mapping[str, FloatArray],
    q_rad: FloatArray,
) -> list[list[dict[str, Any]]]:
    chains: list[list[dict[str, Any]]] = []
    last = ""
    for link, q in zip(moving, q_rad, strict=True):
        carrier, R, p = place[str(link.parent)]
        if carrier != last and carrier in {k.name for k in moving}:
            raise ScenarioError(f"{scenario.urdf}: {link.joint}: only the base may carry two arms")
        if carrier != last:
            chains.append([])
        last = link.name
        axis = np.array(link.axis) / np.linalg.norm(np.array(link.axis))
        R_PL = Rotation.from_quat(link.q_PL_xyzw).as_matrix()
        chains[-1].append(
            _named(pi[link.name])
            | {
                "p_PS_P_m": (p + R @ np.array(link.p_PL_P_m)).tolist(),
                "R_PS": (R @ R_PL).tolist(),
                "axis": axis.tolist(),
                "q_rad": float(q),
                "qd_rad_s": 0.0,
            }
        )
    return chains


def _slide(line: SloshMass) -> dict[str, Any]:
    """Return the engine's description of one mass of `on_lines`."""
    return _sprung(line) | {"mass_kg": line.mass_kg, "place_m": line.place_m}


def _hinge(panel: Panel) -> dict[str, Any]:
    """Return a panel as one hinged link with spring and damper, at rest."""
    body = np.array([panel.mass_kg, *panel.com_m, *panel.inertia_kg_m2])
    still = {"R_PS": np.eye(3).tolist(), "q_rad": 0.0, "qd_rad_s": 0.0}
    return _sprung(panel) | still | _named(pi_of(body)) | {"p_PS_P_m": panel.place_m}


def _sprung(part: Sprung) -> dict[str, Any]:
    """Return a part's axis, and the stiffness and damping along or about this axis."""
    rate = 2.0 * np.pi * part.frequency_hz
    return {
        "axis": (np.array(part.axes[0]) / np.linalg.norm(part.axes[0])).tolist(),
        "stiffness": part.moved * rate**2,
        "damping": 2.0 * part.damping_ratio * part.moved * rate,
    }


def _named(pi: FloatArray) -> dict[str, Any]:
    report = report_of(pi)
    return {
        "mass_kg": float(report[0]),
        "com_m": report[1:4].tolist(),
        "inertia_kg_m2": symmetric(report[4:]).tolist(),
    }


def _report(body: Body) -> FloatArray:
    return np.array([body.mass_kg, *body.com_m, *body.inertia_kg_m2])
