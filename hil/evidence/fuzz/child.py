"""One target in a process of its own, under atheris.

`python -m hil.evidence.fuzz.child TARGET [OPTIONS of libFuzzer]`.

The flight software, and what it reads files' units with, is instrumented as it is imported.
libFuzzer ends the process itself: with 0 when the runs are done, else after writing the input that
failed.
"""

import sys

import atheris

INSTRUMENTED = ["fsw", "cfdppy", "spacepackets"]


def main(arguments: list[str]) -> None:
    """Fuzz one target until libFuzzer ends the process."""
    name, *options = arguments
    with atheris.instrument_imports(include=INSTRUMENTED):
        from hil.evidence.fuzz.table import make

        one = make(name)
    atheris.Setup([f"fuzz-{name}", *options], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1:])
