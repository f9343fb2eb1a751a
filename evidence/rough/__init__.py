"""A rough world, declared or undeclared; and an ideal world, for the cost of the declarations."""

from evidence.declaration import declared, seeds, several

COMMAND = declared(
    "rough",
    "friction, wrong links, coloured noise: honest?",
    "hil rough --case target --count 50 --out runs/rough",
    "evidence.rough.command:run",
    several("--case", ("target", "base", "both"), "what is unknown"),
    several(
        "--told",
        ("declared", "undeclared", "exact", "terms", "defaults"),
        "rough world declared or undeclared; ideal one, declared as exact, with the terms of the "
        "rough one, with default uncertainties",
    ),
    *seeds(50, "list"),
)
