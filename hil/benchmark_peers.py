"""Peers of the benchmark on the same data: regressors and recursions of other packages, as ratios.

Each needs its package (`pip install .[peers]`); without it a line says what was left out. The
packages of `NOT_COMPARED` are no part of that extra.
"""

from __future__ import annotations

import importlib
import importlib.util
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.estimators.online import OnlineEstimator, build_online
from fsw.estimators.problem import Problem
from fsw.estimators.samples import SampleSet
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import Block, FloatArray

SAMPLE_RATE_HZ = 500.0
RECURSION_SAMPLES = 300
REGRESSOR_SAMPLES = 2000
RIDGE = 1e-6  # information of the recursions' start

NOT_COMPARED = (
    "figaroh: its import needs meshcat and more that the benchmark does not install",
    "mujoco.sysid: needs mujoco[sysid]; it fits roll-outs, not a regression",
)

Timer = Callable[[Callable[[], object], int], float]
Figure = tuple[str, float, float | None]  # name, value, upper bound


def available(package: str) -> bool:
    """Tell whether a peer is installed."""
    return importlib.util.find_spec(package) is not None


def idyntree_regressor(problem: Problem, samples: SampleSet, urdf: str) -> Callable[[], object]:
    """Return a loop over the samples of iDynTree's inverse dynamics regressor."""
    idyn: Any = importlib.import_module("idyntree.bindings")
    loader = idyn.ModelLoader()
    if not loader.loadReducedModelFromFile(urdf, list(problem.model.joint_names)):
        raise ValueError(f"iDynTree cannot read {urdf}")
    dynamics = idyn.KinDynComputations()
    dynamics.loadRobotModel(loader.model())
    dynamics.setFrameVelocityRepresentation(idyn.BODY_FIXED_REPRESENTATION)
    links = int(loader.model().getNrOfLinks())
    out = idyn.MatrixDynSize(6 + samples.n, 10 * links)
    base, gravity = np.eye(4), np.zeros(3)

    def loop() -> object:
        for i in range(min(len(samples), REGRESSOR_SAMPLES)):
            velocity = np.concatenate([np.zeros(3), samples.w_NB_B[i]])
            acceleration = np.concatenate([samples.a_NB_B[i], samples.wd_NB_B[i]])
            dynamics.setRobotState(base, samples.q[i], velocity, samples.qd[i], gravity)
            dynamics.inverseDynamicsInertialParametersRegressor(acceleration, samples.qdd[i], out)
        return out

    return loop


def recursions(rows: FloatArray, height: int, seconds: Timer) -> list[Figure]:
    """Compare one update of p states by one sample's rows (height, p+1) with two peers."""
    p = rows.shape[1] - 1
    parts = rows[: RECURSION_SAMPLES * height].reshape(-1, height, p + 1)

    def own() -> object:
        state = SquareRootInformation.from_prior(np.zeros(p), np.eye(p) / RIDGE)
        for part in parts:
            state = state.update(part[:, :p], part[:, p])
        return state

    figures: list[Figure] = []
    spent = seconds(own, 3)
    if available("filterpy"):
        kalman: Any = importlib.import_module("filterpy.kalman")

        def by_filterpy() -> object:
            peer = kalman.KalmanFilter(dim_x=p, dim_z=height)
            peer.P = np.eye(p) / RIDGE
            for part in parts:
                peer.update(part[:, p], R=np.eye(height), H=part[:, :p])
            return peer

        figures.append(
            ("recursion / filterpy's Kalman filter", spent / seconds(by_filterpy, 2), None)
        )
    if available("padasip"):
        padasip: Any = importlib.import_module("padasip")

        def by_padasip() -> object:
            peer = padasip.filters.FilterRLS(p, mu=1.0, eps=RIDGE, w="zeros")
            for part in parts:
                for row in part:
                    peer.adapt(row[p], row[:p])
            return peer

        figures.append(("recursion / padasip's RLS", spent / seconds(by_padasip, 2), None))
    return figures


def online_update(config: Config, blocks: list[Block], call_s: float) -> list[Figure]:
    """Return the daemon's estimator time in regressor calls: per 500 Hz sample and per unit."""
    online = build_online(config)
    if not isinstance(online, OnlineEstimator):
        return []
    units: list[float] = []
    begin = time.process_time()
    for block in blocks:
        online.push(block)
        more = True
        while more:
            start = time.process_time()
            more = online.work()
            units.append(time.process_time() - start)
    spent = time.process_time() - begin
    samples = len(blocks) * config.estimator.window_s * SAMPLE_RATE_HZ
    return [
        ("online estimator per 500 Hz sample / regressor call", spent / samples / call_s, 15.0),
        ("  longest unit of work / regressor call", max(units) / call_s, None),
    ]
