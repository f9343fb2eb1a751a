"""Write every form of the dictionary: `python -m offline.exports [FOLDER]`.

The files are part of the source; a test compares them with the dictionary.
"""

import argparse
import sys
from pathlib import Path

from offline.exports import FOLDER, write


def main(argv: list[str] | None = None) -> int:
    """Write all files, remove tables of packets that no longer exist; return the exit code 0."""
    parser = argparse.ArgumentParser(prog="offline.exports", description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(), help="of the project")
    folder = parser.parse_args(argv).folder / FOLDER
    written = write(folder)
    for old in {*(folder / "ccsdspy").glob("*.csv")} - {*written}:
        old.unlink()
    print(f"{len(written)} files written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
