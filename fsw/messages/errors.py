"""The errors of the flight software; anything else is a programmer's mistake."""

MEMORY_EXIT = 76  # exit status of a service process that the system refused memory


class FswError(Exception):
    """Base of every error the flight software raises on purpose."""


class ConfigError(FswError, ValueError):
    """The configuration is wrong; the message names key, value and bound."""


class PortError(FswError, OSError):
    """A device link failed or could not be opened."""


class CommandError(FswError):
    """A command was refused; `code` is the reason published to the operator."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(f"{code}: {message}")
        self.code = code


class EstimatorError(FswError):
    """An estimate cannot be given: not observable, or diverged."""
