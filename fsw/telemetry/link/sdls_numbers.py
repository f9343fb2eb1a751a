"""The IVs used with each key, kept so that no crash reopens an old one."""

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from file_delivery.durable import replace_file
from fsw.messages.errors import ConfigError

NUMBERS_NAME = "uplink_numbers.json"  # in the state directory


@dataclass(slots=True)
class _Key:
    floor: int = 0  # lowest IV never used, as a number of 96 bits
    kept_floor: int = 0  # the same in the file; never below
    retired: bool = False


class NumberStore:
    """The lowest IV never used of every key ever seen, in one file.

    The file is replaced whole, and holds IVs ahead of those used: what a crash finds there is
    always above every IV that had an effect. Keys are remembered by fingerprint, so that one
    taken out and put back does not start again at zero.

    Raises
    ------
    ConfigError when the file is damaged: nothing is accepted on a guess.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._keys: dict[str, _Key] = {}
        self.is_new = not path.exists()
        if not self.is_new:
            self._keys = _read(path)

    def floor(self, fingerprint: str) -> int:
        """Return the lowest IV never used."""
        return self._key(fingerprint).floor

    def is_retired(self, fingerprint: str) -> bool:
        """Whether the key is never to be accepted again."""
        return self._key(fingerprint).retired

    def claim(self, fingerprint: str, used: int, kept: int) -> None:
        """Use all up to `used`; across a crash nothing below `kept` comes back. Raises OSError.

        The file is written only when it holds less than is used, or more than is to be kept.
        """
        key = self._key(fingerprint)
        if not used < key.kept_floor <= kept:
            self._keep({fingerprint: kept})
        key.floor = used + 1

    def retire(self, fingerprint: str) -> None:
        """Never accept this key again, not even after a restart. Raises OSError."""
        self._key(fingerprint).retired = True
        self._keep({})

    def settle(self, floors: Mapping[str, int]) -> None:
        """Keep exactly these lowest IVs never used. Raises OSError."""
        self._keep(floors)
        for name, floor in floors.items():
            self._key(name).floor = floor

    def _key(self, fingerprint: str) -> _Key:
        return self._keys.setdefault(fingerprint, _Key())

    def _keep(self, floors: Mapping[str, int]) -> None:
        for name in floors:
            self._key(name)
        kept = {
            name: {"floor": floors.get(name, key.kept_floor), "retired": key.retired}
            for name, key in sorted(self._keys.items())
        }
        document = {"keys": kept, "crc32": _crc32(kept)}
        replace_file(self._path, json.dumps(document), 0o600)
        for name, floor in floors.items():
            self._keys[name].kept_floor = floor


def _crc32(kept: object) -> int:
    return zlib.crc32(json.dumps(kept, sort_keys=True).encode())


def _read(path: Path) -> dict[str, _Key]:
    try:
        document = json.loads(path.read_bytes())
        kept = document["keys"]
        if document["crc32"] != _crc32(kept):
            raise ValueError("its CRC is wrong")
        return {
            name: _Key(
                floor=int(key["floor"]), kept_floor=int(key["floor"]), retired=bool(key["retired"])
            )
            for name, key in kept.items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(
            f"{path}: numbers of the authenticated uplink cannot be read: {error}; "
            "give new keys and remove the file"
        ) from error
