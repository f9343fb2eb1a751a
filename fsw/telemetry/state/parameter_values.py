"""Values of the on-board parameters: commanded (kept over a restart), configured or default."""

import json
from collections.abc import Mapping
from typing import Any

from fsw.config import Config
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.state.documents import read_document
from fsw.telemetry.state.store import GenerationStore

ESTIMATOR = {  # parameter -> key of the section `estimator`; forgetting_time_s 0 is null there
    "gate_probability": "gate_probability",
    "condition_limit": "condition_limit",
    "forgetting_time_s": "forgetting_time_s",
    "settle_blocks": "settle_blocks",
}
BY_NAME = {item.name: item for item in DICTIONARY.parameters}


class ParameterValues:
    """Returns and stores the value in use of each parameter.

    A telecommand's value has precedence over the configuration's, and that over the default.

    Parameters
    ----------
    config : configuration as read from its file
    store : file of the commanded values, one generation for each change

    Attributes
    ----------
    commanded : values set by telecommand, by parameter name
    damaged : stored generations that cannot be read
    """

    def __init__(self, config: Config, store: GenerationStore) -> None:
        self.store = store
        self.commanded, self.damaged = stored_values(store)
        self._base = _configured(config)

    def get(self, name: str) -> float:
        """Return the value in use."""
        return self.commanded.get(name, self._base[name])

    def prepare(self, values: Mapping[str, float]) -> int:
        """Write values to the disk, not yet in use; return their generation. Raises OSError."""
        return self.store.prepare(json.dumps(values, sort_keys=True).encode())

    def commit(self, number: int, values: dict[str, float]) -> None:
        """Make a prepared generation of values the one in use. Raises OSError."""
        self.store.commit(number)
        self.commanded = values


def stored_values(store: GenerationStore) -> tuple[dict[str, float], int]:
    """Return the newest valid commanded values, and the number of invalid generations."""
    values, damaged = read_document(store, _parse)
    return values or {}, damaged


def estimator_changes(values: Mapping[str, float]) -> dict[str, Any]:
    """Return the keys of the section `estimator` that the parameters change, with new values."""
    changes: dict[str, Any] = {
        key: values[name] for name, key in ESTIMATOR.items() if name in values
    }
    if "forgetting_time_s" in changes:
        changes["forgetting_time_s"] = changes["forgetting_time_s"] or None
    if "settle_blocks" in changes:
        changes["settle_blocks"] = int(changes["settle_blocks"])
    return changes


def _parse(document: Any) -> dict[str, float]:  # noqa: ANN401
    """Return values by name. Raises KeyError, TypeError, ValueError or AttributeError."""
    values = {str(name): float(value) for name, value in document.items()}
    for name, value in values.items():
        item = BY_NAME[name]
        if not item.minimum <= value <= item.maximum:
            raise ValueError(f"{name} {value}: must be {item.minimum} to {item.maximum}")
    return values


def _configured(config: Config) -> dict[str, float]:
    values = {item.name: float(item.default) for item in DICTIONARY.parameters}
    section = config.estimator.model_dump()
    values |= {name: float(section[key] or 0.0) for name, key in ESTIMATOR.items()}
    return values
