"""Write every form of the dictionary: `python -m offline.exports [FOLDER]`.

The files are part of the source; a test compares them with the dictionary.
"""

import argparse
import sys
from pathlib import Path

from offline.exports import FOLDER, documents


def main(argv: list[str] | None = None) -> int:
    """Write all files, remove tables of packets that no longer exist; return the exit code 0."""
    parser = argparse.ArgumentParser(prog="offline.exports", description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(), help="of the project")
    folder = parser.parse_args(argv).folder
    found = documents()
    for old in (folder / FOLDER / "ccsdspy").glob("*.csv"):
        if str(old.relative_to(folder)) not in found:
            old.unlink()
    for name, text in found.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    print(f"{len(found)} files written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
