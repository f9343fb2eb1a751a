"""A web page of another site reads nothing of the live page; an open address needs a token."""

import asyncio
import re
from contextlib import asynccontextmanager

import pytest
from aiohttp import WSServerHandshakeError
from aiohttp.test_utils import TestClient, TestServer

from ground.__main__ import main
from ground.errors import UsageError
from ground.gateway.guard import Guard, is_loopback, read_token
from ground.gateway.server import application
from tests.support.fake_daemon import FakeDaemon, run_of_estimates

TOKEN = "a token of many characters"
READS = ("/", "/objects", "/latest/estimate.target_mass_kg", "/history/events?start=0&end=1e15")


@asynccontextmanager
async def gateway(assets, guard=None, port=1):
    app = application("127.0.0.1", port, assets, None, guard or Guard("127.0.0.1"))
    async with TestClient(TestServer(app)) as client:
        yield client


async def status(client, path, **headers) -> int:
    async with client.get(path, headers=headers, allow_redirects=False) as answer:
        return answer.status


def test_another_site_cannot_open_the_stream(assets):
    async def check(port):
        async with gateway(assets, port=port) as client:
            for origin in ("https://evil.example", "null", "http://127.0.0.1:1", "http://[::1]"):
                with pytest.raises(WSServerHandshakeError, match="403"):
                    await client.ws_connect("/stream", headers={"Origin": origin})
            own = str(client.make_url("")).rstrip("/")
            async with client.ws_connect("/stream", headers={"Origin": own}) as socket:
                assert await socket.receive_json()

    with FakeDaemon(stream=run_of_estimates()) as daemon:
        asyncio.run(check(daemon.port))


def test_another_sites_scripts_cannot_read(assets):
    async def check():
        async with gateway(assets) as client:
            for path in READS:
                assert await status(client, path) == 200
                assert await status(client, path, Origin="https://evil.example") == 403
                for site in ("cross-site", "same-site"):
                    headers = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "no-cors"}
                    assert await status(client, path, **headers) == 403
            followed_link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
            assert await status(client, "/", **followed_link) == 200

    asyncio.run(check())


def test_a_name_that_was_pointed_at_this_server_reaches_nothing(assets):
    async def check():
        async with gateway(assets) as client:
            for host in (
                "evil.example",
                "evil.example:8080",
                "127.0.0.1.evil.example",
                "",
                "[::2]",
            ):
                for path in READS:
                    assert await status(client, path, Host=host) == 403, host
            for host in ("localhost", "LocalHost:9", "127.0.0.1:8080", "[::1]:8080", "[::1]"):
                assert await status(client, "/objects", Host=host) == 200, host

    asyncio.run(check())


def test_every_answer_binds_the_browser(assets):
    async def check():
        async with gateway(assets) as client:
            for path in (*READS, "/static/plugin.js", "/openmct/openmct.js", "/nothing"):
                async with client.get(path) as answer:
                    policy = answer.headers["Content-Security-Policy"]
                    assert "default-src 'none'" in policy
                    assert "frame-ancestors 'none'" in policy
                    assert answer.headers["X-Content-Type-Options"] == "nosniff"
                    assert "Access-Control-Allow-Origin" not in answer.headers
            page = await (await client.get("/")).text()
            assert not re.search(r"<script>|\son[a-z]+=|javascript:", page), "the policy forbids it"

    asyncio.run(check())


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.1", "robot.example", ""])
def test_an_open_address_needs_a_token(host, assets, capsys):
    assert not is_loopback(host)
    with pytest.raises(UsageError, match="--http-token"):
        Guard(host)
    assert main(["serve", "--http-host", host, "--assets", str(assets)]) == 2
    assert "--http-token" in capsys.readouterr().err


def test_with_a_token_nothing_is_shown_without_it(assets):
    async def check():
        async with gateway(assets, Guard("0.0.0.0", TOKEN)) as client:
            for path in (*READS, "/static/plugin.js", "/?token=wrong", f"/objects?token={TOKEN}"):
                assert await status(client, path, Host="robot.example") == 401
            with pytest.raises(WSServerHandshakeError, match="401"):
                await client.ws_connect("/stream")
            assert await status(client, "/objects", Authorization="Bearer wrong") == 401
            assert await status(client, "/objects", Authorization=f"Bearer {TOKEN}") == 200
            async with client.get("/", params={"token": TOKEN}, allow_redirects=False) as answer:
                assert (answer.status, answer.headers["Location"]) == (303, "/")
                cookie = answer.headers["Set-Cookie"]
                assert "HttpOnly" in cookie
                assert "SameSite=Strict" in cookie
            assert await status(client, "/objects") == 200  # the client has kept the cookie
            assert await status(client, "/objects", Origin="https://evil.example") == 403
            async with client.ws_connect("/stream") as socket:
                assert await socket.receive_json()

    asyncio.run(check())


@pytest.mark.parametrize(
    ("text", "mode", "words"),
    [("short", 0o600, "at least 16"), (TOKEN, 0o640, "0600"), (None, 0, "cannot be read")],
)
def test_a_token_is_long_and_closed_to_others(tmp_path, text, mode, words):
    path = tmp_path / "token"
    if text is not None:
        path.write_text(text + "\n")
        path.chmod(mode)
    with pytest.raises(UsageError, match=words):
        read_token(path)


def test_a_token_is_read_without_its_line_end(tmp_path):
    path = tmp_path / "token"
    path.write_text(TOKEN + "\n")
    path.chmod(0o600)
    assert read_token(path) == TOKEN
