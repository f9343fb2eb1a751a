"""The truth of a motion, stored for other processes if HIL_TRUTH_CACHE names a folder.

A stored truth is used if arguments, sources of this package and libraries are equal; otherwise the
motion is simulated. Tests set the folder, so that one simulation serves all runs of a scenario.
"""

import os
import pickle
from collections.abc import Callable
from contextlib import suppress
from functools import cache, wraps
from hashlib import sha256
from pathlib import Path
from typing import ParamSpec
from uuid import uuid4

import mujoco
import numpy as np

from hil.world.contact import Contact, Fixture
from hil.world.environment.config import EnvironmentSection
from hil.world.history import TruthHistory
from hil.world.robot import Robot
from hil.world.spline import Motion
from hil.world.stand import Stand
from hil.world.truth import STILL, simulate

P = ParamSpec("P")


@cache
def _code() -> bytes:
    """Return a digest of the sources and library versions that determine a truth."""
    sources = sorted(Path(__file__).parent.rglob("*.py"))
    versions = f"{mujoco.__version__} {np.__version__}".encode()
    return sha256(versions + b"".join(path.read_bytes() for path in sources)).digest()


def kept(make: Callable[P, TruthHistory]) -> Callable[P, TruthHistory]:
    """Return `make` with a store of results, which equal calls in all processes share."""

    @wraps(make)
    def read_or_make(*args: P.args, **kwargs: P.kwargs) -> TruthHistory:
        folder = os.environ.get("HIL_TRUTH_CACHE")
        if not folder:
            return make(*args, **kwargs)
        path = Path(folder) / sha256(_code() + pickle.dumps((args, kwargs))).hexdigest()
        with suppress(OSError, EOFError, pickle.UnpicklingError):
            found = pickle.loads(path.read_bytes())
            if isinstance(found, TruthHistory):
                return found
        made = make(*args, **kwargs)
        with suppress(OSError):  # if it cannot be stored, it is simulated again
            part = path.with_name(uuid4().hex)
            part.write_bytes(pickle.dumps(made))
            part.rename(path)
        return made

    return read_or_make


@kept
def simulate_in(
    section: EnvironmentSection | None,
    robot: Robot,
    spline: Motion,
    start_s: float,
    end_s: float,
    dt_s: float = 0.004,
    stand: Stand | None = None,
    w_NB_B_rad_s: tuple[float, float, float] = STILL,
    contact: Contact | None = None,
) -> TruthHistory:
    """Return the truth of a motion, free, in an environment, on a stand or with a contact."""
    if section is None:
        return simulate(
            robot,
            spline,
            start_s,
            end_s,
            dt_s,
            wrench=None if contact is None else Fixture(contact),
            stand=stand,
            w_NB_B_rad_s=w_NB_B_rad_s,
        )
    if contact is not None:
        raise ValueError("contact: not with an environment")
    from hil.world.environment.wrench import Environment  # imports numba: 0.25 s

    around = Environment(section, robot, start_s, end_s)
    return simulate(
        robot,
        spline,
        start_s,
        end_s,
        dt_s,
        wrench=around,
        field=around.field,
        q_NB_xyzw=section.attitude_xyzw,
        w_NB_B_rad_s=w_NB_B_rad_s,
    )
