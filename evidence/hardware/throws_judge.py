"""Judge recorded throws: compare the body without the device with its true moments.

The calibration throws give the device's inertia and the wheel's inertia, to which all identified
values are proportional. Their covariance is a part of the covariance of every error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from evidence.hardware import throws
from evidence.hardware.throws import Body, FloatArray, moved


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The identification of one throw, of the body with the device."""

    name: str
    status: str
    mean: FloatArray  # (10,) m, m c, inertia xx xy yy xz yz zz about the inertial unit; or empty
    covariance: FloatArray  # (10, 10)


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The result of one set of throws."""

    name: str
    throws: int
    found: int  # throws with an estimate
    valid: int  # throws with a valid estimate
    mean_percent: float  # norm of the errors of the principal moments over the moments' norm
    worst_percent: float
    nees: float  # mean NEES of the three moments; about 3 if sigma is right
    nees_median: float


def judged(sets: dict[str, list[Found]]) -> list[Result]:
    """Return the errors of every set of throws; `sets` also has the two calibration sets."""
    device, proof = (pooled(sets[name]) for name in ("device_only", "proof_body"))
    results = []
    for name, places in throws.SETS.items():
        body, errors, squares = throws.frame_with_blocks(places), [], []
        truth = np.linalg.eigvalsh(body.inertia_kg_m2)
        for found in sets[name]:
            if not found.mean.size:
                continue
            parts = ((found.mean, found.covariance), device, proof)
            x, P = np.concatenate([part[0] for part in parts]), block_diag(*[p[1] for p in parts])
            G = _slopes(partial(_moments, body), x, P)
            off, covariance = _moments(body, x) - truth, G @ P @ G.T
            errors.append(100.0 * float(np.linalg.norm(off) / np.linalg.norm(truth)))
            squares.append(float(off @ np.linalg.solve(covariance, off)))
        results.append(
            Result(
                name=name,
                throws=len(sets[name]),
                found=len(errors),
                valid=sum(found.status == "OK" for found in sets[name]),
                mean_percent=float(np.mean(errors)),
                worst_percent=float(np.max(errors)),
                nees=float(np.mean(squares)),
                nees_median=float(np.median(squares)),
            )
        )
    return results


def pooled(throws_of_one: Sequence[Found]) -> tuple[FloatArray, FloatArray]:
    """Return mean (10,) and covariance (10, 10) of a body's throws, weighted by their information.

    If the throws scatter by more than their covariances, the covariance is larger (Birge ratio).
    """
    own = [found for found in throws_of_one if found.mean.size]
    weights = [np.linalg.solve(found.covariance, np.eye(10)) for found in own]
    P = np.linalg.solve(np.sum(weights, axis=0), np.eye(10))
    mean = P @ sum(W @ found.mean for W, found in zip(weights, own, strict=True))
    off = [found.mean - mean for found in own]
    square = sum(float(d @ W @ d) for W, d in zip(weights, off, strict=True))
    return mean, P * max(1.0, square / max(1, 9 * (len(own) - 1)))  # 9, because the mass is known


def _moments(body: Body, x: FloatArray) -> FloatArray:
    """Return the principal moments (3,) [kg m2] of a body.

    x (30,): identified values of body with device, of the device, and of proof body with device.
    """
    (I_both, c_both), (I_device, c_device), (I_proof, c_proof) = map(_central, x.reshape(3, 10))
    added, gained = _with_device(throws.proof_body(), c_device, c_proof), I_proof - I_device
    scale = np.sum(added * gained) / np.sum(gained * gained)
    shifts = _with_device(Body(body.mass_kg, np.zeros((3, 3))), c_device, c_both)
    return np.asarray(np.linalg.eigvalsh(scale * (I_both - I_device) - shifts))


def _slopes(
    function: Callable[[FloatArray], FloatArray], x: FloatArray, P: FloatArray
) -> FloatArray:
    """Return the derivative (3, k) by central differences with steps of 0.01 sigma."""
    steps = np.sqrt(np.diag(P)) * 1e-2
    return np.array(
        [
            (function(x + d) - function(x - d)) / (2.0 * step)
            for d, step in zip(np.diag(steps), steps, strict=True)
        ]
    ).T


def _central(mean: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return inertia (3, 3) [kg m2] about the centre of mass, and the centre of mass (3,) [m]."""
    mass, c = mean[0], mean[1:4] / mean[0]
    xx, xy, yy, xz, yz, zz = mean[4:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - moved(mass, c), c


def _with_device(body: Body, c_device: FloatArray, c_both: FloatArray) -> FloatArray:
    """Return the inertia (3, 3) that a body adds to the device; c are the centres of mass (3,)."""
    s = c_device - c_both
    r = throws.DEVICE_KG / body.mass_kg * s
    return body.inertia_kg_m2 + moved(body.mass_kg, r) + moved(throws.DEVICE_KG, s)
