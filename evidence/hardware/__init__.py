"""Recordings of real arms and thrown bodies, imported and identified as by a user, and judged."""

from pathlib import Path

from evidence.declaration import declared, option

COMMAND = declared(
    "hardware",
    "recordings of real arms, fetched if wanted",
    "hil hardware --data ~/recordings --fetch",
    "evidence.hardware.command:run",
    option("--data", type=Path, required=True, metavar="DIR", help="where the recordings lie"),
    option("--fetch", action="store_true", help="load what is missing from GitHub"),
    option(
        "--repository",
        type=Path,
        action="append",
        default=[],
        dest="repositories",
        metavar="DIR",
        help="with --fetch: a local git repository of the data; may be repeated",
    ),
    option(
        "--arm",
        action="append",
        default=[],
        dest="arms",
        metavar="NAME",
        help="this one, such as ur10e; may be repeated; default: all",
    ),
    option("--held-out", action="store_true", help="judge also the runs that no choice has used"),
    option("--out", type=Path, metavar="DIR", help="keep what was imported"),
    option("--json", action="store_true", dest="as_json", help="print one JSON list"),
    option(
        "--throws",
        action="store_true",
        help="of thrown bodies with a reaction wheel instead; needs orangebox",
    ),
)
