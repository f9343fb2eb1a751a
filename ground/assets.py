"""The files of Open MCT: fetched once by npm, checked, and served unchanged."""

import base64
import hashlib
import os
import subprocess
import tarfile
from pathlib import Path
from tempfile import TemporaryDirectory

from ground.errors import FAILED, GroundError

PACKAGE = "openmct@4.2.0"
SHA512 = "3fprUHT5s22kBukpHC0WTWeW12UnD+JgehJN9KqjJoBbj928LV4um9FjHSRZG+P+6rAKZZD9+DFumVbDzJ4lHg=="
PREFIX = "package/dist/"
ENTRY = "openmct.js"
NPM_TIMEOUT_S = 300.0


def default_folder() -> Path:
    """Return the folder of these files in the user's cache."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    return Path(cache) / "inertia-ground" / PACKAGE.replace("@", "-")


def fetch(folder: Path) -> Path:
    """Fetch the files unless they exist; return their folder. Raises GroundError."""
    if (folder / ENTRY).exists():
        return folder
    with TemporaryDirectory() as temporary:
        command = ["npm", "pack", "--silent", "--ignore-scripts", PACKAGE]
        try:
            done = subprocess.run(
                command,
                cwd=temporary,
                capture_output=True,
                text=True,
                timeout=NPM_TIMEOUT_S,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise GroundError(f"npm: {error}", FAILED) from error
        packed = list(Path(temporary).glob("*.tgz"))
        if done.returncode or not packed:
            raise GroundError(f"npm pack {PACKAGE}: {done.stderr.strip()}", FAILED)
        data = packed[0].read_bytes()
        if base64.b64encode(hashlib.sha512(data).digest()).decode() != SHA512:
            raise GroundError(f"{PACKAGE}: not the file that is known", FAILED)
        _unpack(packed[0], folder)
    return folder


def _unpack(archive: Path, folder: Path) -> None:
    """Unpack the files that a browser needs; move them to `folder` when all are complete."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder.parent) as temporary, tarfile.open(archive) as tar:
        new = Path(temporary) / "dist"
        for member in tar:
            name = member.name
            if not (member.isfile() and name.startswith(PREFIX)) or name.endswith(".map"):
                continue
            source = tar.extractfile(member)
            path = (new / name.removeprefix(PREFIX)).resolve()
            if source is None or not path.is_relative_to(new.resolve()):
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(source.read())
        new.replace(folder)
