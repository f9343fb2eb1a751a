"""The web server of the live page: files, objects, history, and a stream of live values."""

import argparse
import asyncio
import json
import os
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from aiohttp import WSMsgType, web

from ground.assets import ENTRY, default_folder
from ground.downlink import ClearStream, PacketStream
from ground.errors import GroundError, UsageError
from ground.gateway.connections import NEXT_REQUEST_S, Connections
from ground.gateway.desk import Desk
from ground.gateway.feed import Feed
from ground.gateway.guard import Guard, random_token, read_token, sender
from ground.gateway.history import Recordings, thinned
from ground.gateway.objects import page_objects
from ground.gateway.points import EVENTS, Points, health_bits

STATIC = Path(__file__).parent / "static"
CONNECTIONS = web.AppKey("connections", Connections)
PERIOD_S = 0.1  # shortest time between two messages to a client
KEPT = 50  # most values of a point that wait for a client; more drop the oldest
MAX_SIZE = 5000
MAX_PAGES = 50  # open at one time
MAX_MESSAGE_BYTES = 1 << 20  # of a page
BODY_S = 10.0  # time for the body of a request


class PageClient:
    """One open page: its subscriptions, and the values and events that wait for it."""

    def __init__(self) -> None:
        self.wanted: set[str] = set()
        self.waiting: dict[str, deque[list[float]]] = {}
        self.events: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self.dropped = 0

    def offer(self, packet: str, t_ms: float, numbers: dict[str, float]) -> None:
        """Keep the subscribed numbers of a packet until the next message."""
        for field, value in numbers.items():
            key = f"{packet}.{field}"
            if key not in self.wanted:
                continue
            waiting = self.waiting.setdefault(key, deque(maxlen=KEPT))
            self.dropped += len(waiting) == KEPT
            waiting.append([t_ms, value])

    def take(self) -> dict[str, Any]:
        """Return the waiting values and events, and clear them."""
        points = {key: list(values) for key, values in self.waiting.items()}
        events = list(self.events)
        self.waiting.clear()
        self.events.clear()
        return {"points": points, "events": events}


class Gateway:
    """Handlers of the page's requests."""

    def __init__(
        self,
        host: str,
        port: int,
        recordings: Recordings,
        make_stream: Callable[[], PacketStream],
        desk: Desk | None = None,
    ) -> None:
        self._desk = desk  # None: the page may not command
        self._one_command = asyncio.Lock()  # commands are sent one at a time
        self._points, self._recordings = Points(), recordings
        self.feed = Feed(host, port, self._points, self.take, make_stream)
        self._clients: set[PageClient] = set()
        self._damage: set[str] = set()  # lines on damaged recordings that were reported
        self._objects = page_objects(self._points)

    def take(self, packet: str, t_ms: float, numbers: dict[str, float]) -> None:
        """Offer a packet to every open page."""
        for client in self._clients:
            if packet == EVENTS:
                client.events.append(self.feed.events[-1])
            else:
                client.offer(packet, t_ms, numbers)

    async def index(self, _request: web.Request) -> web.FileResponse:
        """Return the overview page."""
        return web.FileResponse(STATIC / "summary.html")

    async def explore(self, _request: web.Request) -> web.FileResponse:
        """Return the page of Open MCT, which shows every value of the dictionary."""
        return web.FileResponse(STATIC / "index.html")

    async def words(self, _request: web.Request) -> web.Response:
        """Return the names of bits and labels, and the telecommands if the page may command."""
        labels = {p.key: p.labels for p in self._points.by_key.values() if p.labels is not None}
        commands = [] if self._desk is None else self._desk.commands()
        words = {"bits": health_bits(self._points), "labels": labels}
        return web.json_response(
            words | {"commands": commands, "may_command": self._desk is not None}
        )

    async def command(self, request: web.Request) -> web.Response:
        """Send a telecommand that was confirmed on the page; return its outcome or the error."""
        if self._desk is None:
            raise web.HTTPForbidden(text="this page may look only")
        if request.content_type != "application/json":
            raise web.HTTPUnsupportedMediaType(text="application/json")
        try:
            async with asyncio.timeout(BODY_S):
                message = await request.json()
            name, given = str(message["name"]), message["arguments"]
            given = {str(key): str(value) for key, value in given.items()}
            confirmed = message["confirmed"] is True
        except (
            *(ValueError, KeyError, TypeError, AttributeError, RecursionError, TimeoutError),
        ) as error:
            raise web.HTTPBadRequest(text="name, arguments, confirmed") from error
        if not confirmed:
            raise web.HTTPBadRequest(text="not confirmed")
        loop = asyncio.get_running_loop()
        try:
            async with self._one_command:
                answer = await loop.run_in_executor(
                    None, self._desk.send, name, given, sender(request)
                )
        except GroundError as error:
            answer = {"error": str(error)}
        return web.json_response(answer)

    async def objects(self, _request: web.Request) -> web.Response:
        """Return all objects of the page's tree."""
        return web.json_response(self._objects)

    async def history(self, request: web.Request) -> web.Response:
        """Return the values of a point within an interval, from recordings and memory."""
        key = request.match_info["key"]
        try:
            start_ms, end_ms = (float(request.query[name]) for name in ("start", "end"))
            size = min(int(request.query.get("size", MAX_SIZE)), MAX_SIZE)
        except (KeyError, ValueError) as error:
            raise web.HTTPBadRequest(text="start, end, size: numbers") from error
        if key == EVENTS:
            return web.json_response((await self._old_events(start_ms, end_ms))[-size:])
        point = self._points.by_key.get(key)
        if point is None:
            raise web.HTTPNotFound(text=key)
        rows = self.feed.between(point.packet, point.field, start_ms, end_ms)
        if point.packet == "estimate":
            until_ms = min(end_ms, float(rows[0, 0])) if len(rows) else end_ms
            offset_ms = self.feed.offset_ms
            loop = asyncio.get_running_loop()
            old = await loop.run_in_executor(
                None, self._recordings.between, point.field, start_ms, until_ms, offset_ms
            )
            rows = np.concatenate((old, rows))
        return web.json_response(thinned(rows, size))

    async def latest(self, request: web.Request) -> web.Response:
        """Return the newest value of a point, [[time in ms, value]]; [] if there is none."""
        packet, _, field = request.match_info["key"].partition(".")
        t_ms, numbers = self.feed.latest.get(packet, (0.0, {}))
        found = [[t_ms, numbers[field]]] if field in numbers else []
        return web.json_response(found)

    async def stream(self, request: web.Request) -> web.WebSocketResponse:
        """Send live values, staleness and the state of the link until the page is closed."""
        if len(self._clients) >= MAX_PAGES:
            raise web.HTTPServiceUnavailable(text=f"{MAX_PAGES} pages are open; close one")
        socket = web.WebSocketResponse(heartbeat=10.0, max_msg_size=MAX_MESSAGE_BYTES)
        await socket.prepare(request)
        client = PageClient()
        self._clients.add(client)
        sender = asyncio.create_task(self._send(socket, client))
        try:
            async for message in socket:
                if message.type == WSMsgType.TEXT:
                    _change_wanted(client, message.data, self._points)
        finally:
            self._clients.discard(client)
            sender.cancel()
            with suppress(asyncio.CancelledError, ConnectionError):
                await sender
        return socket

    async def _send(self, socket: web.WebSocketResponse, client: PageClient) -> None:
        shown: tuple[bool, set[str], int] | None = None
        while not socket.closed:
            message = client.take()
            unknown = self.feed.unknown.total()
            state = self.feed.connected, self.feed.stale_packets(), unknown
            if state != shown:
                shown = state
                link = {"connected": state[0], "reason": self.feed.reason}
                message |= {"link": link, "stale": sorted(state[1]), "unknown": unknown}
            if any(message.values()) or "stale" in message:
                await socket.send_str(json.dumps(message | {"dropped": client.dropped}))
            await asyncio.sleep(PERIOD_S)

    async def _old_events(self, start_ms: float, end_ms: float) -> list[dict[str, Any]]:
        live = [event for event in self.feed.events if start_ms <= event["utc"] <= end_ms]
        until_ms = live[0]["utc"] - 1.0 if live else end_ms
        old = await asyncio.get_running_loop().run_in_executor(
            None, self._recordings.events, start_ms, until_ms, self.feed.offset_ms
        )
        self._report_damage()
        return [*old, *live]

    def _report_damage(self) -> None:
        """Add an event for each recording that cannot be read to its end."""
        for line in self._recordings.unreadable:
            if line not in self._damage:
                self._damage.add(line)
                self.feed.add_event("low", "RECORDING_DAMAGED", line, time.time_ns() / 1e6)


def _change_wanted(client: PageClient, text: str, points: Points) -> None:
    """Change a page's subscriptions to points that exist; ignore an invalid message."""
    try:
        message = json.loads(text)
        client.wanted |= points.by_key.keys() & set(map(str, message.get("subscribe", ())))
        client.wanted -= set(map(str, message.get("unsubscribe", ())))
    except (ValueError, AttributeError, TypeError, RecursionError):
        return


def application(
    host: str,
    port: int,
    assets: Path,
    recordings: Path | None,
    guard: Guard,
    make_stream: Callable[[], PacketStream] = ClearStream,
    desk: Desk | None = None,
) -> web.Application:
    """Return the web application.

    Raises
    ------
    UsageError when the files of Open MCT are missing, or when the page may command without a token.
    """
    if desk is not None and not guard.needs_token:
        raise UsageError("a page that may command needs a token: every local user reaches it")
    if not (assets / ENTRY).exists():
        raise UsageError(f"{assets}: Open MCT is not there; run `ground fetch-assets`")
    gateway = Gateway(host, port, Recordings(recordings), make_stream, desk)
    connections = Connections()
    app = web.Application(middlewares=[connections.middleware(), guard.middleware()])
    app[CONNECTIONS] = connections
    app.on_response_prepare.append(guard.add_headers)
    app.add_routes(
        [
            web.get("/", gateway.index),
            web.get("/explore", gateway.explore),
            web.get("/words", gateway.words),
            web.post("/command", gateway.command),
            web.get("/objects", gateway.objects),
            web.get("/history/{key}", gateway.history),
            web.get("/latest/{key}", gateway.latest),
            web.get("/stream", gateway.stream),
            web.static("/static", STATIC),
            web.static("/openmct", assets),
        ]
    )

    async def reading(_app: web.Application) -> AsyncIterator[None]:
        task = asyncio.create_task(gateway.feed.run())
        yield
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task

    app.cleanup_ctx.append(reading)
    return app


def serve(
    arguments: argparse.Namespace, make_stream: Callable[[], PacketStream], desk: Desk | None
) -> int:
    """Print the page's address and serve until interrupted; return 0."""
    assets = arguments.assets or default_folder()
    query, token = "", None
    if arguments.http_token is not None:
        token = read_token(arguments.http_token)
    elif desk is not None:
        token = random_token()
        query = f"?token={token}"
    guard = Guard(arguments.http_host, token)
    app = application(
        arguments.host, arguments.port, assets, arguments.recordings, guard, make_stream, desk
    )
    host, port = arguments.http_host, arguments.http_port
    try:
        asyncio.run(_serve(app, host, port, query))
    except OSError as error:  # asyncio's text is longer than the system's
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise UsageError(f"--http-host {host} --http-port {port}: {reason}") from error
    return 0


async def _serve(app: web.Application, host: str, port: int, query: str) -> None:
    runner = web.AppRunner(app, access_log=None, keepalive_timeout=NEXT_REQUEST_S)
    await runner.setup()
    watching = asyncio.create_task(app[CONNECTIONS].watch(runner))
    site = web.TCPSite(runner, host, port)
    await site.start()
    shown = runner.addresses[0]
    print(f"http://{shown[0]}:{shown[1]}/{query}", flush=True)
    try:
        await asyncio.Event().wait()
    finally:
        watching.cancel()
        await runner.cleanup()
