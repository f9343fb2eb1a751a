"""Coverage-guided fuzzing of every parser that reads bytes from outside."""

from pathlib import Path

from evidence.declaration import DRAWN, RESUMED, declared, option

COMMAND = declared(
    "fuzz",
    "coverage-guided fuzzing of every byte parser",
    "hil fuzz --inputs 1e6 --only stim300 --out runs/fuzz",
    "evidence.fuzz.command:run",
    option("--inputs", type=float, default=1e7, metavar="N", help="in all, 1e7"),
    DRAWN,
    RESUMED,
    option("--keep", type=Path, metavar="DIR", help="copy a small corpus there"),
    option("--only", default="", metavar="TARGET", help="all inputs for one target"),
    option("--live", action="store_true", help="with --only operations: real processes, N cases"),
    option(
        "--random", action="store_true", help="with --only operations: N cases, no coverage, fast"
    ),
)
