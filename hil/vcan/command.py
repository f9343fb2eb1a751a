"""`hil vcan -- COMMAND`: on this kernel's CAN, else in User-Mode Linux."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from hil.vcan import kernel, uml
from hil.vcan.job import FAILED, Job, VcanError


def run(argv: Sequence[str], *, timeout_s: float | None = None, where: str = "auto") -> int:
    """Run a command with a vcan0 and a vcan1; return its exit status.

    Parameters
    ----------
    where : `kernel` or `uml`; `auto`: the kernel if it has CAN and the links can be had
    """
    env = {"OPENBLAS_NUM_THREADS": "1", **os.environ, "HIL_VCAN": "1"}
    job = Job(argv=argv, cwd=str(Path.cwd()), env=env, timeout_s=timeout_s)
    try:
        if where != "uml":
            with kernel.provided() as ready:
                if ready:
                    return kernel.run(job)
                if where == "kernel":
                    raise VcanError("this kernel has no vcan0 and vcan1, or they cannot be made")
        return uml.run(job)
    except VcanError as error:
        sys.stderr.write(f"hil vcan: {error}\n")
        return FAILED
