"""Study of the identification methods: their errors over the Cramer-Rao bound, for many seeds."""

from pathlib import Path

from evidence.declaration import declared, option
from hil.options import count, count_or_none

COMMAND = declared(
    "study methods",
    "every identification method against the Cramer-Rao bound",
    "hil study methods --quick --out runs/methods",
    "evidence.methods.command:methods",
    option("--quick", action="store_true", help="few seeds of one case"),
    option("--out", type=Path, metavar="DIR", help="keep results and resume from them"),
    option("--seeds", type=count, metavar="N", help="of the sample level, 200"),
    option("--device-seeds", type=count_or_none, metavar="N", help="of the device bytes, 30"),
    option("--jobs", type=count, default=2, metavar="N", help="processes, 2"),
    option("--redo", action="append", default=[], metavar="METHOD", help="drop its stored results"),
    option(
        "--report",
        action="store_true",
        dest="report_only",
        help="run nothing, judge what is stored",
    ),
)
