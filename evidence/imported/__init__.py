"""Identification from tables that a laboratory would record: motion, static poses, a wrist."""

from evidence.declaration import declared, seeds, several

COMMAND = declared(
    "imported",
    "tables of an arm: motion, poses, a wrist",
    "hil imported --motion poses --first 100 --count 10",
    "evidence.imported.command:run",
    several("--motion", ("moving", "poses"), "this one"),
    *seeds(10, "list"),
)
