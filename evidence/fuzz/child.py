"""Fuzz one target in this process with atheris.

`python -m evidence.fuzz.child TARGET [OPTIONS of libFuzzer]`.

Imports of the flight software and of its libraries for file delivery are instrumented. libFuzzer
ends the process: with exit code 0 after all runs, or with another after it has written the input
that failed.
"""

import sys

import atheris

INSTRUMENTED = ["fsw", "cfdppy", "spacepackets"]


def main(arguments: list[str]) -> None:
    """Fuzz one target until libFuzzer ends the process."""
    name, *options = arguments
    with atheris.instrument_imports(include=INSTRUMENTED):
        from evidence.fuzz.table import make

        one = make(name)
    atheris.Setup([f"fuzz-{name}", *options], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1:])
