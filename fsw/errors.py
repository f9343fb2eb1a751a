"""The errors of the flight software, and functions that keep their messages short.

Any other exception is a programmer's mistake.
"""

from contextlib import suppress
from reprlib import Repr

from file_delivery.extras import cure

MAX_CHARACTERS = 400
_BRIEF = Repr()
_BRIEF.maxlist = _BRIEF.maxtuple = 8
_BRIEF.maxdict = _BRIEF.maxlevel = 3
_BRIEF.maxstring = _BRIEF.maxother = 100


def brief(value: object) -> str:
    """Return the representation of a value, each of its parts cut short."""
    with suppress(ValueError):  # a whole number has too many digits
        return _BRIEF.repr(value)
    return f"a {type(value).__name__} too long to be shown"


def cut(text: str, limit: int = MAX_CHARACTERS) -> str:
    """Return a text cut to a limit, marked where it was cut."""
    return text if len(text) <= limit else text[: limit - 4] + " ..."


MEMORY_EXIT = 76  # exit status of a service process that could not get memory


class FswError(Exception):
    """Base of every error the flight software raises on purpose."""


class ConfigError(FswError, ValueError):
    """The configuration is wrong; the message names key, value and bound."""


class PortError(FswError, OSError):
    """A device link failed or could not be opened."""


class CommandError(FswError):
    """A command was refused; `code` is the reason published to the operator."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(cut(f"{code}: {message}"))
        self.code = code


class EstimatorError(FswError):
    """An estimate cannot be given: not observable, or diverged."""


# errors of a parser on JSON or MessagePack of another form than its own
WRONG_CONTENT = (
    LookupError,
    TypeError,
    ValueError,
    AttributeError,
    ArithmeticError,
    RecursionError,
)
# errors that arithmetic on received numbers may raise; LinAlgError is a ValueError
NUMERICAL = (EstimatorError, ValueError, ArithmeticError)


def in_words(error: Exception, program: str) -> str:
    """Return the message of an error that ends a command of `program`, with its file or cure."""
    if isinstance(error, ModuleNotFoundError):
        return cure(error, program)
    if isinstance(error, OSError) and not isinstance(error, FswError):
        return f"{f'{error.filename}: ' if error.filename else ''}{error.strerror or error}"
    return str(error)


def unforeseen(error: Exception) -> str:
    """Return the message, in one line, for an error that is no `FswError`."""
    return cut(" ".join(f"{type(error).__name__}: {error}".split()))
