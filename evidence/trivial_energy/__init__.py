"""Study: why the energy method as printed has a trivial solution."""

from evidence.declaration import declared

COMMAND = declared(
    "study trivial-energy",
    "why CE as printed has a trivial solution",
    "hil study trivial-energy",
    "evidence.methods.command:energy",
)
