"""Study of wheels, thrusters, modes and contact: consistency, and error over the bound."""

from evidence.declaration import declared, option, seeds

COMMAND = declared(
    "study effects",
    "wheels, thrusters, panel, liquid, contact, arms: from samples",
    "hil study effects wheels_leo --count 20 --out runs/effects",
    "evidence.effects.command:run",
    option("scenarios", nargs="*", metavar="SCENARIO", help="every servicer's"),
    *seeds(50, "list"),
)
