"""The fault matrix: every fault in a seeded run, judged by bounds written before the run."""

from pathlib import Path

from evidence.declaration import declared, option, several
from hil.options import count, seed

COMMAND = declared(
    "faults",
    "every fault in a run of its own, against bounds",
    "hil faults --only torque_drift --lane virtual",
    "evidence.fault_matrix.command:run",
    option(
        "--only", action="append", default=[], metavar="NAME", help="this fault; may be repeated"
    ),
    several(
        "--lane",
        ("virtual", "machine", "socketcan", "disk"),
        "in virtual time, of the machine, on a real bus: all of these; disk: alone, 200 bad disks",
        dest="lanes",
    ),
    option("--seed", type=seed, default=1, metavar="N", help="fixes every bit, 1"),
    option("--jobs", type=count, default=2, metavar="N", help="processes, 2"),
    option("--short", action="store_true", help="the selection that the tests run"),
    option("--json", action="store_true", dest="as_json", help="print one JSON object"),
    option("--out", type=Path, metavar="DIR", help="keep outcomes and resume"),
)
