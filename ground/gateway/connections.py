"""Bounds the connections of the live page: their number, and how long one may be silent.

A connection costs memory before its first request is complete, and nothing ends one that sends half
a request. So a connection without a complete request is closed after a while, and when there are
too many the oldest of these goes first.
"""

import asyncio
import time
from collections.abc import Sequence

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware
from aiohttp.web_protocol import RequestHandler

MAX_CONNECTIONS = 100
FIRST_REQUEST_S = 10.0  # time for the first complete request of a connection
NEXT_REQUEST_S = 15.0  # time for each further one
PERIOD_S = 0.5


class Connections:
    """Closes connections that hold a place and ask for nothing."""

    def __init__(self) -> None:
        self._began_s: dict[RequestHandler, float] = {}
        self._asked: set[RequestHandler] = set()

    def middleware(self) -> Middleware:
        """Return the middleware that notes which connections have sent a complete request."""

        @web.middleware
        async def note(request: web.Request, handler: Handler) -> web.StreamResponse:
            self._asked.add(request.protocol)
            return await handler(request)

        return note

    async def watch(self, runner: web.AppRunner) -> None:
        """Close silent connections of the server until cancelled."""
        while True:
            if runner.server is not None:
                self.close_silent(runner.server.connections, time.monotonic())
            await asyncio.sleep(PERIOD_S)

    def close_silent(self, connections: Sequence[RequestHandler], now_s: float) -> None:
        """Close the connections that are silent for too long, or too many, at a time [s]."""
        self._asked &= set(connections)
        silent = [one for one in connections if one not in self._asked]
        self._began_s = {one: self._began_s.get(one, now_s) for one in silent}
        silent.sort(key=lambda one: self._began_s[one])
        excess = len(connections) - MAX_CONNECTIONS
        for place, one in enumerate(silent):
            if place < excess or now_s - self._began_s[one] > FIRST_REQUEST_S:
                one.force_close()
