"""Speed: benchmarks of the flight software, each compared with a reference."""

from pathlib import Path

from evidence.declaration import declared, option, several
from hil.options import count

COMMAND = declared(
    "bench",
    "the whole daemon in real time, alone and loaded",
    "hil bench target_leo --rounds 3 --only alone",
    "evidence.speed.command:run",
    option("scenario", nargs="?", default="target_leo", metavar="SCENARIO"),
    option("--rounds", type=count, default=5, metavar="N", help="of every condition, 5"),
    option("--seconds", type=float, default=30.0, metavar="S", help="of a run, 30"),
    several("--only", ("alone", "hog", "batch", "clients"), "this condition"),
    option(
        "--bus",
        choices=("udp_multicast", "udp_frames"),
        default="udp_multicast",
        help="udp_frames: frames as sockets of SocketCAN hand them over",
    ),
    option("--out", type=Path, metavar="DIR", help="keep the runs and resume"),
    option("--json", action="store_true", dest="as_json", help="print one JSON object"),
)
