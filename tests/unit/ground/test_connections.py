"""Connections that ask for nothing end; those that ask are served."""

import asyncio

import pytest
from aiohttp import ClientSession, web

from ground.gateway import connections as module
from ground.gateway.connections import MAX_CONNECTIONS, Connections


async def answer(_request: web.Request) -> web.Response:
    return web.Response(text="here")


async def stream(request: web.Request) -> web.WebSocketResponse:
    socket = web.WebSocketResponse()
    await socket.prepare(request)
    async for message in socket:
        await socket.send_str(message.data)
    return socket


async def opened(port: int, text: bytes) -> asyncio.StreamReader:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(text)
    reader.writer = writer  # keeps it open
    return reader


async def ended(reader: asyncio.StreamReader) -> bool:
    try:
        return await asyncio.wait_for(reader.read(), 20.0) is not None
    except ConnectionError:
        return True


@pytest.mark.parametrize("text", [b"", b"GET / HTTP/1.1\r\nHost: 127", b"POST / HTTP/1.1\r\n"])
def test_half_a_request_holds_no_place(monkeypatch, text):
    monkeypatch.setattr(module, "PERIOD_S", 0.05)
    monkeypatch.setattr(module, "FIRST_REQUEST_S", 1.0)

    async def check():
        held = Connections()
        app = web.Application(middlewares=[held.middleware()])
        app.add_routes([web.get("/", answer), web.get("/stream", stream)])
        runner = web.AppRunner(app)
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        port = runner.addresses[0][1]
        watching = asyncio.create_task(held.watch(runner))
        url = f"http://127.0.0.1:{port}/"
        async with ClientSession() as session, session.ws_connect(f"{url}stream") as socket:
            silent = [await opened(port, text) for _ in range(3 * MAX_CONNECTIONS)]
            async with session.get(url) as response:
                assert await response.text() == "here"
            assert all(await asyncio.gather(*map(ended, silent)))
            assert len(runner.server.connections) <= 2
            for reader in silent:
                reader.writer.close()
            await socket.send_str("still open")
            assert await socket.receive_str() == "still open"
        watching.cancel()
        await runner.cleanup()

    asyncio.run(check())
