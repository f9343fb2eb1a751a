"""Public recordings: their address, their licence, and the SHA-256 of every file."""

import hashlib
import os
import subprocess
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

RAW = "https://raw.githubusercontent.com"
TIMEOUT_S = 60.0


class DataError(Exception):
    """Data are missing or differ from the published data; the message is one line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSet:
    """Files of one commit of a public repository."""

    what: str  # description
    repository: str  # owner/name at GitHub
    commit: str
    licence: str
    files: Mapping[str, str]  # path in the repository -> SHA-256

    def place(self, folder: Path, path: str) -> Path:
        """Return the local path of a file below the folder of data."""
        return folder / self.repository / path

    def fetch(
        self,
        folder: Path,
        tell: Callable[[str], None],
        repositories: Sequence[Path] = (),
        raw: str = RAW,
    ) -> None:
        """Write the files that are missing, from a local git repository or else from GitHub.

        Parameters
        ----------
        repositories : git directories; the first that has a file's commit and content gives it

        Raises
        ------
        DataError if a file cannot be loaded, or if its SHA-256 is wrong.
        """
        for path in self.files:
            place = self.place(folder, path)
            if place.exists():
                continue
            url = f"{raw}/{self.repository}/{self.commit}/{quote(path)}"
            data = self._local(path, repositories)
            if data is None:
                tell(f"{url} ({self.licence})")
                data = _downloaded(url)
            self._judge(path, data, url)
            place.parent.mkdir(parents=True, exist_ok=True)
            part = place.with_name(place.name + ".part")
            part.write_bytes(data)
            os.replace(part, place)

    def read(self, folder: Path, path: str) -> Path:
        """Check a file and return its local path.

        Raises
        ------
        DataError if the file is missing, or if its SHA-256 is wrong.
        """
        place = self.place(folder, path)
        if not place.exists():
            raise DataError(
                f"{place}: not there; --fetch loads it from github.com/{self.repository}"
            )
        self._judge(path, place.read_bytes(), str(place))
        return place

    def _local(self, path: str, repositories: Sequence[Path]) -> bytes | None:
        for repository in repositories:
            command = ["git", "-C", str(repository), "cat-file", "blob", f"{self.commit}:{path}"]
            done = subprocess.run(command, capture_output=True, check=False)
            if done.returncode == 0:
                return done.stdout
        return None

    def _judge(self, path: str, data: bytes, where: str) -> None:
        found = hashlib.sha256(data).hexdigest()
        if found != self.files[path]:
            raise DataError(f"{where}: SHA-256 {found}, not {self.files[path]}")


def _downloaded(url: str) -> bytes:
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_S) as answer:
            data: bytes = answer.read()
    except (urllib.error.URLError, OSError) as error:
        raise DataError(f"{url}: cannot be loaded: {error}") from error
    return data
