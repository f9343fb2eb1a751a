"""Recorded throws of a body with one wheel: the logs, and the true properties of the bodies.

The owners of the recordings give these properties: weighed masses, and sizes from drawings.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evidence.hardware.data_set import DataError, DataSet

FloatArray = NDArray[np.float64]

POLE_PAIRS = 7
COUNTS_PER_DEG_S, COUNTS_PER_G, G_M_S2 = 16.384, 2048.0, 9.81
TURNING_RAD_S = 10.0  # above this speed the wheel turns
# Delay of a measured speed in electrical revolutions. The steps of the speed show that the motor's
# controller averages over more revolutions if one is shorter than a millisecond. Of all values
# tried, these leave the smallest residuals in the calibration throws.
FAST_RAD_S, SLOW_REVOLUTIONS, FAST_REVOLUTIONS = 895.0, 0.7, 2.4
SKIPPED_S = 0.05  # after the motor's start, because its first speeds are not measured
NEEDED = ("time", *(f"gyroADC[{k}]" for k in range(3)), *(f"accSmooth[{k}]" for k in range(3)))
R_BS = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # mounting of the board
DEVICE_KG, PROOF_KG, FRAME_KG, BLOCK_KG = 0.10067, 0.346, 0.1785, 0.0701
PROOF_M, BLOCK_M = (0.0600, 0.0700, 0.0302), (0.015, 0.015, 0.040)
FRAME_COM_M = np.array([0.0, 0.0, -18.9e-3])
FRAME_KG_M2 = FRAME_KG / 145.2 * np.diag([0.2994, 0.1004, 0.3506])
SETS = {  # the blocks (#) on the frame's grid of 4 by 8 places
    "config_empty": "........ ........ ........ ........",
    "config_a": "........ #......# #......# ........",
    "config_b": "..#..#.. ...##... ...##... ..#..#..",
    "config_c": "#.#..#.# .#.##.#. .#.##.#. #.#..#.#",
}
PUBLISHED = {  # errors of the owners' tool, rerun here: mean and worst, principal moments [%]
    "config_empty": (1.64, 2.30),
    "config_a": (1.74, 6.62),
    "config_b": (1.81, 4.34),
    "config_c": (2.49, 4.07),
}


def _files() -> dict[str, str]:
    lines = Path(__file__).with_name("throws.txt").read_text(encoding="utf-8").splitlines()
    return {path: digest for digest, path in (line.split() for line in lines)}


THROWS = DataSet(
    what="45 throws and 10 of calibration, 4 kHz: TU Delft, arXiv 2503.13137",
    repository="tudelft/inertiaEstimation",
    commit="f83da372839384ebd2919f066f526dd93b249af6",
    licence="no licence stated: to look at only",
    files=_files(),
)


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Mass, and inertia (3, 3) about the centre of mass; zero for a point mass."""

    mass_kg: float
    inertia_kg_m2: FloatArray


def moved(mass_kg: float, by_m: FloatArray) -> FloatArray:
    """Return the inertia (3, 3) [kg m2] of a point mass at `by_m` (3,) about the origin."""
    return np.asarray(mass_kg * (by_m @ by_m * np.eye(3) - np.outer(by_m, by_m)))


def _cuboid(mass_kg: float, sides_m: tuple[float, ...]) -> FloatArray:
    squares = np.square(sides_m)
    return np.asarray(mass_kg / 12.0 * np.diag(squares.sum() - squares))


def proof_body() -> Body:
    """Return the body of known inertia with which the device is calibrated."""
    return Body(PROOF_KG, _cuboid(PROOF_KG, PROOF_M))


def frame_with_blocks(places: str) -> Body:
    """Return the frame with a block at every # of `places`."""
    grid = np.argwhere(np.array([list(row) for row in places.split()]) == "#")
    at = np.column_stack([0.018 * grid[:, 0] - 0.027, 0.018 * grid[:, 1] - 0.063])
    parts = [(FRAME_KG, FRAME_COM_M, FRAME_KG_M2)]
    own = _cuboid(BLOCK_KG, BLOCK_M)
    parts += [(BLOCK_KG, np.array([x, y, -0.022]), own) for x, y in at.tolist()]
    mass = sum(part[0] for part in parts)
    com = np.asarray(sum(part[0] * part[1] for part in parts)) / mass
    inertia = sum(own + moved(m, place - com) for m, place, own in parts)
    return Body(mass, np.asarray(inertia))


def _rows(log: Path) -> FloatArray:
    """Return the needed columns of a log. Raises DataError."""
    try:
        parser = import_module("orangebox").Parser.load(str(log))
        names = list(parser.field_names)
        columns = [names.index(name) for name in (*NEEDED, "erpm[0]")]
        return np.array([[frame.data[k] for k in columns] for frame in parser.frames()], float)
    except ImportError as error:
        raise DataError("blackbox logs need orangebox: pip install orangebox") from error
    except Exception as error:  # orangebox raises what its parser meets
        raise DataError(f"{log}: cannot be read: {error}") from error


def write_csv(log: Path, path: Path) -> None:
    """Write the samples of a log after the wheel's start to a CSV file for `fsw import`.

    Raises
    ------
    DataError if the log cannot be read, the wheel never turns, or orangebox is not installed.
    """
    rows = _rows(log)
    speed = rows[:, 7] * 100.0 / POLE_PAIRS * 2.0 * np.pi / 60.0
    turning = np.flatnonzero(speed > TURNING_RAD_S)
    if not len(turning):
        raise DataError(f"{log}: the wheel does not turn")
    t_s = (rows[:, 0] - rows[turning[0], 0]) * 1e-6
    own = t_s >= SKIPPED_S
    rate = np.radians(rows[:, 1:4] / COUNTS_PER_DEG_S) @ R_BS.T
    force = rows[:, 4:7] / COUNTS_PER_G * G_M_S2 @ R_BS.T
    revolution_s = 2.0 * np.pi / POLE_PAIRS / np.maximum(speed, TURNING_RAD_S)
    late = np.where(speed < FAST_RAD_S, SLOW_REVOLUTIONS, FAST_REVOLUTIONS)
    wheel_s = np.maximum.accumulate(1.0 + t_s - late * revolution_s)
    table = np.column_stack([1.0 + t_s, rate, force, wheel_s, speed])[own]
    header = "t,wx,wy,wz,fx,fy,fz,t_wheel,speed"
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")
