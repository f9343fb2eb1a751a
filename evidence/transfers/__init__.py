"""Many file transfers, some interrupted: each must end with the right file or with a reason."""

from evidence.declaration import DRAWN, RESUMED, declared, option
from hil.options import count

COMMAND = declared(
    "transfers",
    "file transfers, a quarter interrupted",
    "hil transfers --count 20 --out runs/transfers",
    "evidence.transfers.command:run",
    option("--count", type=count, default=200, metavar="N", help="in all, 200"),
    DRAWN,
    RESUMED,
)
