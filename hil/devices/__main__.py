"""The plant in real time: `python -m hil.devices PLANT.yaml`."""

import sys
from collections.abc import Sequence
from pathlib import Path


def main(arguments: Sequence[str]) -> int:
    """Run the real-time plant until SIGTERM."""
    from hil.devices.realtime import run

    if len(arguments) != 1:
        sys.stderr.write("usage: python -m hil.devices PLANT.yaml\n")
        return 2
    return run(Path(arguments[0]))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
