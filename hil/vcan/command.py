"""`hil vcan -- COMMAND`: run a command on this kernel's CAN, else in User-Mode Linux."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from hil.vcan import kernel, uml
from hil.vcan.job import FAILED, Job, VcanError


def run(
    argv: Sequence[str],
    *,
    timeout_s: float | None = None,
    where: str = "auto",
    realtime: bool = False,
) -> int:
    """Run a command with a vcan0 and a vcan1; return its exit status.

    Parameters
    ----------
    where : `kernel` or `uml`; `auto`: the kernel if it has CAN and the links can be made
    realtime : run User-Mode Linux in SCHED_FIFO on one processor, if that is allowed
    """
    env = {"OPENBLAS_NUM_THREADS": "1", **os.environ, "HIL_VCAN": "kernel"}
    job = Job(argv=argv, cwd=str(Path.cwd()), env=env, timeout_s=timeout_s, realtime=realtime)
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
