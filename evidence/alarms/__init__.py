"""Flights in which nothing is wrong, on seeds that nobody has used: which checks fire."""

from evidence.declaration import declared, option, resumable
from hil.options import count_or_none

COMMAND = declared(
    "alarms",
    "clean flights on fresh seeds: which checks fire?",
    "hil alarms --scenario target_leo --samples 100 --bytes 10 --out runs/alarms",
    "evidence.alarms.command:run",
    option("--scenario", action="append", default=[], help="this one; may be repeated; nine"),
    option(
        "--samples", type=count_or_none, default=1000, metavar="N", help="flights of each, 1000"
    ),
    option(
        "--bytes",
        type=count_or_none,
        default=100,
        metavar="N",
        dest="from_bytes",
        help="flights of each from the devices' bytes, 100",
    ),
    *resumable("flights"),
)
