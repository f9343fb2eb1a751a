"""Study of panels and liquid: sigma over the bound that has them among its unknowns."""

from pathlib import Path

from evidence.declaration import declared, option

COMMAND = declared(
    "study modes",
    "sigma over the bound, of panels and liquid",
    "hil study modes panel_leo --runs runs/panel",
    "evidence.modes.command:study",
    option("scenario", metavar="SCENARIO", help="with panels or liquid, declared"),
    option(
        "--runs", type=Path, required=True, metavar="DIR", help="of `hil seeds SCENARIO --out DIR`"
    ),
)
