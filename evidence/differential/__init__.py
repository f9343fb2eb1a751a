"""Evidence: the same motion with and without the target halves the error."""

from evidence.declaration import declared, seeds

COMMAND = declared(
    "differential",
    "same motion, empty: half the error?",
    "hil differential --count 3",
    "evidence.differential.command:run",
    *seeds(20, "object"),
)
