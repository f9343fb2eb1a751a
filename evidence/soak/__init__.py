"""Days in virtual time under random faults: memory is bounded, slips exact, estimates honest."""

from evidence.declaration import RESUMED, declared, option
from hil.options import count, seed

COMMAND = declared(
    "soak",
    "hours in virtual time under random faults",
    "hil soak --hours 2 --rate 50 --imu-rate 125 --out runs/soak",
    "evidence.soak.command:run",
    option("--hours", type=float, default=2.0, metavar="H", help="virtual, 2"),
    option("--rate", type=float, default=500.0, metavar="HZ", help="bus and loop, 500"),
    option("--imu-rate", type=int, default=500, metavar="HZ", help="500"),
    option("--seed", type=seed, default=0, metavar="K", help="fixes every bit"),
    option("--jobs", type=count, default=1, metavar="N", help="quarters at a time, 1"),
    RESUMED,
)
