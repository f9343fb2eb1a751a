"""States whether data, the prior alone or nothing determines each published parameter.

A light payload's mass and centre of mass can be of use while its inertia is not. So every parameter
has its own verdict, besides the verdict on the estimate as a whole.
"""

from collections.abc import Sequence

import numpy as np

from fsw.messages import BodyEstimate, FloatArray

MEASURED, PRIOR, UNBOUNDED, INVALID = "measured", "prior-dominated", "unbounded", "not valid"
HARMLESS = {"INSUFFICIENT_EXCITATION"}  # reasons that do not affect measured parameters
DATA_GAIN = 1.0  # data's information over the prior's, above which a parameter is measured
NAMES = ("mass", "x", "y", "z", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")

Words = dict[str, str | list[str]]


def usable(reasons: Sequence[str]) -> bool:
    """Return whether measured parameters are of use alone, in spite of these reasons."""
    return HARMLESS.issuperset(reasons)


def parameter_verdicts(
    body: BodyEstimate, prior_sigma: FloatArray, reasons: Sequence[str]
) -> Words:
    """Return a word for the mass, each coordinate of the centre of mass, each element of inertia.

    Unbounded: 1 sigma is larger than the parameter's own size (the mass, the radius of gyration,
    the mean moment of inertia). Prior-dominated: the data say less than the prior did. Not valid:
    a check other than that of the excitation has failed, so that no parameter is of use.

    Parameters
    ----------
    prior_sigma : (10,) of mass, centre of mass, inertia
    reasons : why the estimate is invalid; empty: the estimate is valid
    """
    sigma = np.concatenate(
        [[body.mass_sigma_kg], body.com_sigma_m, body.inertia_sigma_kg_m2], dtype=np.float64
    )
    if not usable(reasons):
        return _grouped([INVALID] * len(NAMES))
    return predicted_verdicts(body.mass_kg, body.inertia_kg_m2, sigma, prior_sigma)


def predicted_verdicts(
    mass_kg: float, inertia_kg_m2: FloatArray, sigma: FloatArray, prior_sigma: FloatArray
) -> Words:
    """Return `parameter_verdicts` for given sigmas (10,); the inertia is xx xy xz yy yz zz."""
    moment = float(np.mean(np.abs(inertia_kg_m2[[0, 3, 5]])))
    radius = float(np.sqrt(moment / max(abs(mass_kg), 1e-300)))
    size = np.repeat([abs(mass_kg), radius, moment], [1, 3, 6])
    return _grouped(
        [
            _word(*values)
            for values in zip(sigma.tolist(), prior_sigma.tolist(), size.tolist(), strict=True)
        ]
    )


def _grouped(words: list[str]) -> Words:
    return {"mass_kg": words[0], "com_m": words[1:4], "inertia_kg_m2": words[4:]}


def _word(sigma: float, prior_sigma: float, size: float) -> str:
    if not sigma <= size:
        return UNBOUNDED
    return MEASURED if sigma**2 * (1.0 + DATA_GAIN) < prior_sigma**2 else PRIOR


def in_words(words: Words) -> str:
    """Return a short text that lists the names of the parameters by their word."""
    groups: dict[str, list[str]] = {}
    every = [words["mass_kg"], *words["com_m"], *words["inertia_kg_m2"]]
    for name, word in zip(NAMES, every, strict=True):
        groups.setdefault(str(word), []).append(name)
    if len(groups) == 1:
        return f"every parameter {next(iter(groups))}"
    return "; ".join(f"{word}: {' '.join(names)}" for word, names in groups.items())
