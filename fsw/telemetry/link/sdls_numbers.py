"""Stores the IVs used with each key, so that no IV is accepted again after a crash."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from file_delivery.slots import SlotFile
from fsw.errors import WRONG_CONTENT, ConfigError

NUMBERS_NAME = "uplink_numbers"  # in the state directory
EARLIER_SUFFIX = ".json"  # of the file in which earlier versions stored the numbers


@dataclass(slots=True)
class _Key:
    floor: int = 0  # lowest IV never used, as a number of 96 bits
    kept_floor: int = 0  # the floor in the file; not below `floor`
    retired: bool = False


class NumberStore:
    """Stores the lowest unused IV of every key, in one file that is written in place.

    Once the file exists, a full disk prevents no write. The stored IV lies ahead of the used ones,
    so after a crash it is above every IV that had an effect. Keys are stored by fingerprint, so
    that a key that is removed and added again does not begin again at zero.

    Raises
    ------
    ConfigError when the file is damaged; no frame may be accepted then.
    """

    def __init__(self, path: Path) -> None:
        self._file = SlotFile(path)
        self._keys: dict[str, _Key] = {}
        self.is_new = not path.exists()
        if not self.is_new:
            self._keys = _read(self._file)
        elif (earlier := path.with_suffix(EARLIER_SUFFIX)).exists():
            raise ConfigError(
                f"{earlier}: numbers of the authenticated uplink of an earlier version; give new "
                "keys and remove the file"
            )

    def prepare(self) -> None:
        """Make the file, while there is room for it. Raises OSError."""
        self._keep({})

    def floor(self, fingerprint: str) -> int:
        """Return the lowest IV that was never used with a key."""
        return self._key(fingerprint).floor

    def is_retired(self, fingerprint: str) -> bool:
        """Return whether the key must never be accepted again."""
        return self._key(fingerprint).retired

    def claim(self, fingerprint: str, used: int, kept: int) -> None:
        """Mark IVs up to `used` as used; after a crash those below `kept` too. Raises OSError.

        The file is written only if its floor is not above `used`, or is above `kept`.
        """
        key = self._key(fingerprint)
        if not used < key.kept_floor <= kept:
            self._keep({fingerprint: kept})
        key.floor = used + 1

    def skip(self, fingerprint: str, used: int) -> None:
        """Mark IVs up to `used` as used in this run only: a restart may accept them again."""
        self._key(fingerprint).floor = used + 1

    def retire(self, fingerprint: str) -> None:
        """Never accept this key again, not even after a restart. Raises OSError."""
        self._key(fingerprint).retired = True
        self._keep({})

    def settle(self, floors: Mapping[str, int]) -> None:
        """Store exactly these lowest unused IVs, by key fingerprint. Raises OSError."""
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
        self._file.write({"keys": kept})
        for name, floor in floors.items():
            self._keys[name].kept_floor = floor


def _read(file: SlotFile) -> dict[str, _Key]:
    try:
        return {
            name: _Key(
                floor=int(key["floor"]), kept_floor=int(key["floor"]), retired=bool(key["retired"])
            )
            for name, key in file.read()["keys"].items()
        }
    except (OSError, *WRONG_CONTENT) as error:
        raise ConfigError(
            f"{file.path}: numbers of the authenticated uplink cannot be read: {error}; "
            "give new keys and remove the file"
        ) from error
