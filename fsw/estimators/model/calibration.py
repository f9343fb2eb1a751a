"""Uncertainty of the known bodies' inertial data, as states of unit prior variance.

A link's data from a drawing are wrong by some per cent. These errors are states. The estimator
therefore removes their effect on the torques from the residuals and counts it in every sigma.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from fsw.config import BodyConfig, Config
from fsw.estimators.model.inertia import (
    PARAMETERS,
    parameters_of_pseudo_inertia,
    pseudo_inertia,
    report_jacobian,
    to_parameters,
)
from fsw.estimators.model.robot import Hold, RobotModel
from fsw.messages import FloatArray

_PAIRS = [(i, j) for i in range(4) for j in range(i, 4)]
_ONE_SIGMA = np.zeros((len(_PAIRS), 4, 4))  # one standard deviation of S, element by element
for _k, (_i, _j) in enumerate(_PAIRS):
    _ONE_SIGMA[_k, _i, _j] = _ONE_SIGMA[_k, _j, _i] = 1.0 if _i == _j else np.sqrt(0.5)
NEGLIGIBLE = 1e-9  # of the longest column: shorter ones count as zero (a rod or a point has some)


def spread_root(pi: FloatArray, ratio: float) -> FloatArray:
    """Return R (10, k): pi + R z with z ~ N(0, 1) is a body that is uncertain by a ratio.

    With the pseudo-inertia P = L L^T, the body becomes P + L S L^T. S is symmetric and Gaussian
    with variance ratio^2 on its diagonal and half of that off the diagonal. The mass is
    uncertain by exactly the ratio, the centre of mass by ratio / sqrt(2) of the body's radii; any
    frame gives the same. Source: the affine-invariant metric of Lee, Park, RA-L 3 (2018).
    """
    values, vectors = np.linalg.eigh(pseudo_inertia(pi))
    L = vectors * np.sqrt(np.maximum(values, 0.0))
    spread = (ratio * L @ _ONE_SIGMA @ L.T).reshape(-1, 16)
    root: FloatArray = parameters_of_pseudo_inertia() @ spread.T
    length = np.linalg.norm(root, axis=0)
    return root[:, length > NEGLIGIBLE * max(float(length.max()), 1e-300)]


def known_bodies(
    config: Config, model: RobotModel, unknown: tuple[str, ...], held: Mapping[str, Hold]
) -> Iterator[tuple[str, FloatArray]]:
    """Yield name and root, within pi (10 (n + 1), k), of every known body that is uncertain."""
    ratio, size = config.robot.links_sigma_ratio, model.pi_links.size
    joints = {joint.name: joint for joint in config.joints}
    for index, name in enumerate(model.body_names):
        own = slice(PARAMETERS * index, PARAMETERS * (index + 1))
        if name == "base":
            if "base" in unknown or config.base.motion == "clamped":
                continue
            root = _body_root(config.bodies.get("base"), model.pi_links[own], ratio)
        else:
            link = joints[name].link_sigma_ratio if name in joints else None
            root = spread_root(model.pi_links[own], ratio if link is None else link)
        yield from _placed("base" if name == "base" else f"link.{name}", root, own, size)
    for name, hold in held.items():
        if name not in unknown:
            root = hold.map @ _body_root(config.bodies[name], np.zeros(PARAMETERS), ratio)
            yield from _placed(name, root, hold.places, size)


def _body_root(body: BodyConfig | None, pi: FloatArray, ratio: float) -> FloatArray:
    """Return the root (10, k) of a known body: from its configured sigma, else from the ratio."""
    if body is None:
        return spread_root(pi, ratio)
    mean = to_parameters(body.mass_kg, np.array(body.com_m), np.array(body.inertia_kg_m2))
    if body.sigma is None:
        return spread_root(mean, ratio)
    sigma = np.concatenate(([body.sigma.mass_kg], body.sigma.com_m, body.sigma.inertia_kg_m2))
    root: FloatArray = np.asarray(np.linalg.solve(report_jacobian(mean), np.diag(sigma)))
    return root


def _placed(
    name: str, root: FloatArray, rows: slice, size: int
) -> Iterator[tuple[str, FloatArray]]:
    if root.any():
        whole = np.zeros((size, root.shape[1]))
        whole[rows] = root
        yield name, whole
