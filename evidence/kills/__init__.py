"""Kill -9 at random times of a real-time run: processes must return, and data must not be lost."""

from evidence.declaration import DRAWN, RESUMED, declared, option
from hil.options import count

COMMAND = declared(
    "kills",
    "kill -9 of loop and service in a real-time run",
    "hil kills --count 20 --out runs/kills",
    "evidence.kills.command:run",
    option("--count", type=count, default=200, metavar="N", help="in all, 200"),
    DRAWN,
    RESUMED,
)
