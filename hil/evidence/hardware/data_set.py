"""Public recordings: where they are, under which licence, and what their bytes must be."""

import hashlib
import os
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

RAW = "https://raw.githubusercontent.com"
TIMEOUT_S = 60.0


class DataError(Exception):
    """Data that are not there, or not what they should be; one line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSet:
    """Files of one commit of a public repository."""

    what: str
    repository: str  # owner/name at GitHub
    commit: str
    licence: str
    files: Mapping[str, str]  # path in the repository -> SHA-256

    def place(self, folder: Path, path: str) -> Path:
        """Return where a file lies below a folder of data."""
        return folder / self.repository / Path(path).name

    def fetch(self, folder: Path, tell: Callable[[str], None], raw: str = RAW) -> None:
        """Load the files that are missing.

        Raises
        ------
        DataError when one cannot be loaded, or has other bytes.
        """
        for path in self.files:
            place = self.place(folder, path)
            if place.exists():
                continue
            url = f"{raw}/{self.repository}/{self.commit}/{quote(path)}"
            tell(f"{url} ({self.licence})")
            try:
                with urllib.request.urlopen(url, timeout=TIMEOUT_S) as answer:
                    data = answer.read()
            except (urllib.error.URLError, OSError) as error:
                raise DataError(f"{url}: cannot be loaded: {error}") from error
            self._judge(path, data, url)
            place.parent.mkdir(parents=True, exist_ok=True)
            part = place.with_name(place.name + ".part")
            part.write_bytes(data)
            os.replace(part, place)

    def read(self, folder: Path, path: str) -> Path:
        """Return where a file is, with the bytes it should have.

        Raises
        ------
        DataError when it is missing, or has other bytes.
        """
        place = self.place(folder, path)
        if not place.exists():
            raise DataError(
                f"{place}: not there; --fetch loads it from github.com/{self.repository}"
            )
        self._judge(path, place.read_bytes(), str(place))
        return place

    def _judge(self, path: str, data: bytes, where: str) -> None:
        found = hashlib.sha256(data).hexdigest()
        if found != self.files[path]:
            raise DataError(f"{where}: SHA-256 {found}, not {self.files[path]}")
