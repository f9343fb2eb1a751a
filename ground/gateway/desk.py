"""Commanding from the page: each telecommand is sent once and followed through its reports."""

from collections.abc import Callable
from contextlib import closing
from typing import Any

from ground.commands import Catalogue
from ground.history import CommandHistory
from ground.link import Link
from ground.telemetry import Sample, TelemetryDecoder
from ground.verification import follow

TIMEOUT_S = 20.0


class Desk:
    """Sends telecommands for the page.

    Parameters
    ----------
    open_link : opens a new link for each command
    """

    def __init__(self, open_link: Callable[[], Link], history: CommandHistory) -> None:
        self._open_link, self._history = open_link, history
        self._catalogue = Catalogue()

    def commands(self) -> list[dict[str, Any]]:
        """Return every telecommand and its arguments as plain values."""
        return [
            {
                "name": command.name,
                "doc": command.doc,
                "warning": command.warning,
                "arguments": [
                    {"name": a.name, "kind": a.kind, "labels": list(a.labels or ()), "doc": a.doc}
                    for a in command.arguments
                ],
            }
            for command in self._catalogue.commands.values()
        ]

    def send(self, name: str, given: dict[str, str], sender: str) -> dict[str, Any]:
        """Send one telecommand; return outcome, reports and answers.

        Parameters
        ----------
        sender : who sent it from the page, for the history

        Raises
        ------
        GroundError if it cannot be sent.
        """
        self._catalogue.build(name, given, 0)  # a wrong command fails before a link is opened
        with closing(self._open_link()) as link:
            packet = self._catalogue.build(name, given, link.next_sequence())
            for verification, _ in follow(link, TelemetryDecoder(), packet, TIMEOUT_S):  # noqa: B007
                pass
        arguments = " ".join(f"{key}={value}" for key, value in given.items())
        self._history.add(name, arguments, verification, f"page, {sender}")
        return {
            "outcome": str(verification.outcome),
            "reports": [_plain(sample) for sample in verification.reports],
            "answers": [_plain(sample) for sample in verification.answers[:50]],
        }


def _plain(sample: Sample) -> dict[str, Any]:
    return {"packet": sample.packet, "values": dict(sample.values)}
