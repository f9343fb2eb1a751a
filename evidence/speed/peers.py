"""Peers of the benchmark on the same data: regressors and recursions of other packages.

Each peer needs its package (`pip install .[peers]`). A peer that is missing, or that rejects the
problem in this run, gives a line of text with the reason.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import io
import warnings
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from types import ModuleType, SimpleNamespace

import numpy as np

from fsw.estimators.model.problem import Problem
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import FloatArray

RECURSION_SAMPLES = 300
REGRESSOR_SAMPLES = 2000
RIDGE = 1e-6  # prior information of the recursions
REFUSALS = (ImportError, AttributeError, KeyError, RuntimeError, TypeError, ValueError)

Timer = Callable[[Callable[[], object], int], float]
Figure = tuple[str, float, float | None]  # name, value, upper bound
Outcome = Figure | str  # a figure, or the reason why there is none


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """Decoded samples of a motion in SI units; quantities of the base are in B."""

    q: FloatArray  # (N, n)
    qd: FloatArray  # (N, n)
    w_NB_B: FloatArray  # (N, 3)
    a: FloatArray  # (N, 6 + n) classical base acceleration, base angular and joint accelerations
    tau: FloatArray  # (N, n)

    def first(self, count: int) -> Samples:
        """Return the first `count` samples."""
        q, qd, w, a, tau = (x[:count] for x in (self.q, self.qd, self.w_NB_B, self.a, self.tau))
        return Samples(q=q, qd=qd, w_NB_B=w, a=a, tau=tau)


def attempt(package: str, compare: Callable[[ModuleType], Iterator[Outcome]]) -> list[Outcome]:
    """Return the figures of a peer, or its error message if the peer cannot be used.

    `compare` gets the imported module. Output and warnings of the peer are suppressed.
    """
    found: list[Outcome] = []
    try:
        with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            module = importlib.import_module(package)
            found += compare(module)
    except REFUSALS as error:
        words = " ".join(str(error).split())
        found.append(f"{package}{_version(package)}: {type(error).__name__}: {words}")
    return found


def _version(package: str) -> str:
    try:
        return " " + importlib.metadata.version(package.split(".", maxsplit=1)[0])
    except importlib.metadata.PackageNotFoundError:
        return ""


def idyntree(
    problem: Problem, samples: Samples, urdf: str, own_s: float, seconds: Timer
) -> list[Outcome]:
    """Compare Pinocchio's loop (`own_s`) with a loop over iDynTree's inverse dynamics regressor."""

    def compare(idyn: ModuleType) -> Iterator[Outcome]:
        loader = idyn.ModelLoader()
        if not loader.loadReducedModelFromFile(urdf, list(problem.model.joint_names)):
            raise ValueError(f"cannot read {urdf}")
        dynamics = idyn.KinDynComputations()
        dynamics.loadRobotModel(loader.model())
        dynamics.setFrameVelocityRepresentation(idyn.BODY_FIXED_REPRESENTATION)
        links = int(loader.model().getNrOfLinks())
        out = idyn.MatrixDynSize(6 + samples.q.shape[1], 10 * links)
        base, gravity = np.eye(4), np.zeros(3)

        def loop() -> object:
            for i in range(len(samples.q)):
                velocity = np.concatenate([np.zeros(3), samples.w_NB_B[i]])
                dynamics.setRobotState(base, samples.q[i], velocity, samples.qd[i], gravity)
                dynamics.inverseDynamicsInertialParametersRegressor(
                    samples.a[i, :6], samples.a[i, 6:], out
                )
            return out

        yield "pinocchio regressor loop / iDynTree's", own_s / seconds(loop, 2), None

    return attempt("idyntree.bindings", compare)


def figaroh(problem: Problem, samples: Samples, own_s: float, seconds: Timer) -> list[Outcome]:
    """Compare Pinocchio's loop with figaroh's rows of the base; try its joint rows first."""
    model = problem.model.model
    robot = SimpleNamespace(model=model, data=model.createData())
    n = len(samples.q)
    q = np.concatenate([np.zeros((n, 6)), np.ones((n, 1)), samples.q], axis=1)
    v = np.concatenate([np.zeros((n, 3)), samples.w_NB_B, samples.qd], axis=1)
    actuated = {"act_idxv": list(range(6, 6 + samples.q.shape[1]))}

    def compare(regressor: ModuleType) -> Iterator[Outcome]:
        joints = regressor.RegressorBuilder(robot, regressor.RegressorConfig())
        try:
            joints.build_basic_regressor(q[:2], v[:2], samples.a[:2], actuated)
        except ValueError as error:
            yield f"figaroh{_version('figaroh')}: no joint rows of a floating base: {error}"
        forces = ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]
        config = regressor.RegressorConfig(
            is_joint_torques=False, is_external_wrench=True, force_torque=forces
        )
        base = regressor.RegressorBuilder(robot, config)
        loop_s = seconds(lambda: base.build_basic_regressor(q, v, samples.a), 2)
        yield "pinocchio regressor loop / figaroh's 6 rows of the base wrench", own_s / loop_s, None

    return attempt("figaroh.tools.regressor", compare)


def recursions(rows: FloatArray, height: int, seconds: Timer) -> list[Outcome]:
    """Compare updates of p states with one sample's rows (height, p + 1) each with two peers."""
    p = rows.shape[1] - 1
    parts = rows[: RECURSION_SAMPLES * height].reshape(-1, height, p + 1)

    def own() -> object:
        state = SquareRootInformation.from_prior(np.zeros(p), np.eye(p) / RIDGE)
        for part in parts:
            state = state.update(part[:, :p], part[:, p])
        return state

    spent = seconds(own, 3)

    def kalman(module: ModuleType) -> Iterator[Outcome]:
        def loop() -> object:
            peer = module.KalmanFilter(dim_x=p, dim_z=height)
            peer.P = np.eye(p) / RIDGE
            for part in parts:
                peer.update(part[:, p], R=np.eye(height), H=part[:, :p])
            return peer

        yield "recursion / filterpy's Kalman filter", spent / seconds(loop, 2), None

    def rls(module: ModuleType) -> Iterator[Outcome]:
        def loop() -> object:
            peer = module.FilterRLS(p, mu=1.0, eps=RIDGE, w="zeros")
            for part in parts:
                for row in part:
                    peer.adapt(row[p], row[:p])
            return peer

        yield "recursion / padasip's RLS", spent / seconds(loop, 2), None

    return attempt("filterpy.kalman", kalman) + attempt("padasip.filters", rls)
