"""A reproduction of the reference paper: its tables and figure, and those of the fused method."""

from pathlib import Path

from evidence.declaration import declared, option
from hil.options import count, count_or_none

COMMAND = declared(
    "study paper",
    "the paper's tables and figure, and the fused estimator",
    "hil study paper --quick",
    "evidence.paper.command:paper",
    option("--quick", action="store_true", help="one seed, 100 Hz, no device bytes"),
    option("--out", type=Path, metavar="DIR", help="keep results and resume from them"),
    option("--seeds", type=count, metavar="N", help="per cell of Tables 4-7, 20"),
    option("--device-seeds", type=count_or_none, metavar="N", help="of the device bytes, 20"),
)
