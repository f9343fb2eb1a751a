"""Mistakes of configuration: each one alone, with the same simulated motion of a correct robot."""

from evidence.declaration import declared, option
from hil.options import seed

COMMAND = declared(
    "mistakes",
    "mistakes of configuration: valid and wrong?",
    "hil mistakes --case target --only 'prior wrong and tight'",
    "evidence.mistakes.command:run_all",
    option(
        "--case",
        action="append",
        default=[],
        help="target, base, both, or bench_target (clamped, under gravity); all",
    ),
    option("--only", action="append", default=[], metavar="NAME", help="this mistake"),
    option("--seed", type=seed, default=0, metavar="K", help="of priors and noise"),
    option(
        "--exact", action="store_true", help="arm and calibration declared as exact, not in doubt"
    ),
    option("--robot", default="", metavar="FILE", help="a scenario of your own robot"),
    option("--json", action="store_true", dest="as_json", help="print one JSON list"),
    option("--recording", action="store_true", help="also import, check and identify a recording"),
)
