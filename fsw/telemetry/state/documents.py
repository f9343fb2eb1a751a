"""Small documents of the services that survive a restart: JSON in generations with a CRC."""

import json
from collections.abc import Callable
from typing import Any, TypeVar

from fsw.errors import WRONG_CONTENT
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.telecommands import TcError
from fsw.telemetry.state.store import GenerationStore

T = TypeVar("T")


def read_document(store: GenerationStore, parse: Callable[[Any], T]) -> tuple[T | None, int]:
    """Return the newest valid document (None without one), and the number of invalid generations.

    Parameters
    ----------
    parse : converts the decoded JSON; raises one of WRONG_CONTENT if it is invalid
    """
    generations, damaged = store.read()
    for generation in generations:
        try:
            return parse(json.loads(generation.content)), damaged
        except WRONG_CONTENT:
            damaged += 1
    return None, damaged


def keep_document(store: GenerationStore, document: object) -> None:
    """Store a document. Raises TcError FAILED; the document before it then stays valid."""
    try:
        store.write(json.dumps(document, sort_keys=True).encode())
    except OSError as error:
        raise TcError(Error.FAILED, text=f"cannot be kept: {error.strerror}") from error
