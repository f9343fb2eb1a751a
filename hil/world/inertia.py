"""Inertial parameters on the bench's side, written independently of the flight software's.

pi = [m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] about the body-frame origin (Pinocchio's
order); a report is [m, cx, cy, cz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz] with the inertia about the centre
of mass. SI units, body axes.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

COUNT = 10
LABELS = ("m", "cx", "cy", "cz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
UNITS = ("kg", "m", "m", "m") + ("kg m2",) * 6


def symmetric(six: FloatArray) -> FloatArray:
    """Return the matrix of (xx, xy, xz, yy, yz, zz)."""
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def six_of(matrix: FloatArray) -> FloatArray:
    """Return (xx, xy, xz, yy, yz, zz) of a symmetric matrix."""
    return np.array([matrix[i, j] for i in range(3) for j in range(i, 3)])


def steiner(mass_kg: float, com_m: FloatArray) -> FloatArray:
    """Return m (c.c 1 - c c^T) (3, 3): inertia about the origin minus that about the CoM."""
    return np.asarray(mass_kg * (com_m @ com_m * np.eye(3) - np.outer(com_m, com_m)))


def pi_of(report: FloatArray) -> FloatArray:
    """Return pi (10,) of a report (10,)."""
    mass, com = float(report[0]), np.asarray(report[1:4], float)
    origin = symmetric(report[4:]) + steiner(mass, com)
    return np.concatenate(([mass], mass * com, _pack(origin)))


def report_of(pi: FloatArray) -> FloatArray:
    """Return the report (10,) of pi (10,); inverse of `pi_of`."""
    com = pi[1:4] / pi[0]
    central = _unpack(pi[4:]) - steiner(float(pi[0]), com)
    return np.concatenate((pi[:1], com, six_of(central)))


def pi_jacobian(report: FloatArray) -> FloatArray:
    """Return d pi / d report (10, 10)."""
    mass, com = report[0], report[1:4]
    J = np.zeros((COUNT, COUNT))
    J[0, 0] = 1.0
    J[1:4, 0] = com
    J[1:4, 1:4] = mass * np.eye(3)
    J[4:, 0] = _pack(steiner(1.0, com))
    for k, unit in enumerate(np.eye(3)):
        cross = np.outer(com, unit)
        J[4:, 1 + k] = _pack(mass * (2 * com[k] * np.eye(3) - cross - cross.T))
    for k, unit in enumerate(np.eye(6)):
        J[4:, 4 + k] = _pack(symmetric(unit))
    return J


def report_covariance(pi: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the report's covariance (10, 10) from the covariance of pi, linearised at pi."""
    J = pi_jacobian(report_of(pi))
    half = np.linalg.solve(J, covariance)
    return np.asarray(np.linalg.solve(J, half.T))


def is_physical(report: FloatArray, margin_ratio: float = 0.0) -> bool:
    """Return whether a body of positive density can have these parameters.

    The mass is positive, and the largest principal moment is below the sum of the others times
    (1 - margin_ratio). With ratio 0 this means a positive definite pseudo-inertia.
    """
    moments = np.linalg.eigvalsh(symmetric(report[4:]))
    apart = (1.0 - margin_ratio) * (moments[0] + moments[1])
    return bool(report[0] > 0 and moments[0] > 0 and moments[2] < apart)


def frame_map(R_AB: FloatArray, p_AB_m: FloatArray) -> FloatArray:
    """Return T (10, 10) with (pi in frame A) = T (pi in frame B); p_AB_m is the origin of B in A.

    Mass, first moment h and inertia J about the origin transform as h' = R h + m p,
    J' = R J R^T + (second-moment terms of the shift).
    """
    columns = []
    for pi in np.eye(COUNT):
        mass, first, J = pi[0], R_AB @ pi[1:4], R_AB @ _unpack(pi[4:]) @ R_AB.T
        mixed = np.outer(p_AB_m, first)
        shift = 2 * (p_AB_m @ first) * np.eye(3) - mixed - mixed.T
        J = J + shift + steiner(mass, p_AB_m)
        columns.append(np.concatenate(([mass], first + mass * p_AB_m, _pack(J))))
    return np.stack(columns, axis=1)


def _pack(J: FloatArray) -> FloatArray:
    return np.array([J[0, 0], J[0, 1], J[1, 1], J[0, 2], J[1, 2], J[2, 2]])


def _unpack(tail: FloatArray) -> FloatArray:
    xx, xy, yy, xz, yz, zz = tail
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
