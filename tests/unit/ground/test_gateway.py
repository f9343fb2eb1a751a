"""The gateway's requests and its stream, without a browser."""

import asyncio
import getpass
import json
import subprocess
import sys
import time
import urllib.error
import urllib.request
from contextlib import asynccontextmanager
from itertools import pairwise

import numpy as np
import pytest
from aiohttp.test_utils import TestClient, TestServer

from fsw.exchange.recording_writer import RecordingWriter
from ground.errors import UsageError
from ground.gateway.desk import Desk
from ground.gateway.feed import Feed
from ground.gateway.guard import Guard
from ground.gateway.history import MAX_ROWS, Recordings, Ring, thinned
from ground.gateway.points import Points
from ground.gateway.server import KEPT, PERIOD_S, PageClient, _change_wanted, application
from ground.history import CommandHistory
from ground.link import Link
from ground.telemetry import TelemetryDecoder
from tests.support.fake_daemon import OUTSIDE, FakeDaemon, packet, run_of_estimates

MASS = "estimate.target_mass_kg"
TOKEN = "a token of many characters"


@asynccontextmanager
async def commanding(port, assets, desk):
    guard = Guard("127.0.0.1", TOKEN)
    app = application("127.0.0.1", port, assets, None, guard, desk=desk)
    shown = {"Authorization": f"Bearer {TOKEN}"}
    async with TestClient(TestServer(app), headers=shown) as client:
        yield client


@asynccontextmanager
async def gateway(port, assets, recordings=None):
    app = application("127.0.0.1", port, assets, recordings, Guard("127.0.0.1"))
    async with TestClient(TestServer(app)) as client:
        yield client


async def received(socket, until, timeout_s=20.0):
    """Return messages up to the first that fits."""
    found = []
    async with asyncio.timeout(timeout_s):
        async for message in socket:
            found.append(json.loads(message.data))
            if until(found[-1]):
                return found
    raise AssertionError(found)


def test_without_open_mct_it_says_what_to_do(tmp_path):
    with pytest.raises(UsageError, match="fetch-assets"):
        application("127.0.0.1", 1, tmp_path, None, Guard("127.0.0.1"))


def test_the_page_and_its_files_are_served(assets):
    async def check():
        async with gateway(1, assets) as client:
            page = await (await client.get("/")).text()
            assert 'src="static/summary.js"' in page
            page = await (await client.get("/explore")).text()
            assert 'src="static/start.js"' in page
            start = await (await client.get("/static/start.js")).text()
            assert "openmct.start(document.getElementById" in start
            assert await (await client.get("/openmct/openmct.js")).text() == "// Open MCT"
            assert (await client.get("/static/plugin.js")).status == 200
            tree = await (await client.get("/objects")).json()
            for item in tree["objects"].values():
                for member in item.get("composition", []):
                    assert member["key"] in tree["objects"], item["name"]
            assert tree["objects"][MASS]["telemetry"]["values"][0]["unit"] == "kg"
            assert (await client.get("/history/nothing.at_all?start=0&end=1")).status == 404
            assert (await client.get(f"/history/{MASS}?start=now")).status == 400

    asyncio.run(check())


def test_live_values_come_at_most_ten_times_a_second(assets):
    async def check(port):
        async with gateway(port, assets) as client, client.ws_connect("/stream") as socket:
            await socket.send_str(json.dumps({"subscribe": [MASS, f"{MASS}_low"]}))
            times, values, bands = [], [], []
            while len(values) < 60:
                message = json.loads((await socket.receive()).data)
                got = message["points"]
                if MASS in got:
                    times.append(asyncio.get_running_loop().time())
                    values += got[MASS]
                    bands += got[f"{MASS}_low"]
                assert set(got) <= {MASS, f"{MASS}_low"}, "only what was asked for"
            assert times[-1] - times[0] >= PERIOD_S * (len(times) - 2)
            assert all(b[0] > a[0] for a, b in pairwise(values))
            assert abs(values[-1][0] / 1e3 - time.time()) < 2.0, "time of day"
            assert all(low[1] < value[1] for low, value in zip(bands, values, strict=True))

    with FakeDaemon(stream=run_of_estimates()) as daemon:
        asyncio.run(check(daemon.port))


def test_a_slow_page_loses_the_oldest_values():
    client = PageClient()
    client.wanted = {MASS}
    for k in range(KEPT + 7):
        client.offer("estimate", float(k), {"target_mass_kg": float(k), "nis": 1.0})
    message = client.take()
    assert message["points"] == {MASS: [[float(k), float(k)] for k in range(7, KEPT + 7)]}
    assert client.dropped == 7
    assert client.take()["points"] == {}


def test_staleness_is_told_when_packets_are_overdue_and_when_the_link_is_lost(assets):
    async def check(daemon):
        async with gateway(daemon.port, assets) as client, client.ws_connect("/stream") as socket:
            live = await received(socket, lambda m: m.get("stale") == [])
            assert live[-1]["link"]["connected"]
            async with asyncio.timeout(20.0):
                while len(await (await client.get(f"/history/{MASS}?start=0&end=1e15")).json()) < 9:
                    await asyncio.sleep(0.05)
            daemon.pause.set()
            overdue = await received(socket, lambda m: "estimate" in m.get("stale", []))
            assert overdue[-1]["link"]["connected"]
            assert "batch" not in overdue[-1]["stale"], "never came, so not overdue"
            daemon.pause.clear()
            await received(socket, lambda m: m.get("stale") == [])
            daemon.stop()
            lost = await received(socket, lambda m: "link" in m and not m["link"]["connected"])
            assert "batch" in lost[-1]["stale"], "without a link everything is stale"

    with FakeDaemon(stream=run_of_estimates()) as daemon:
        asyncio.run(check(daemon))


def test_events_are_streamed_and_kept(assets):
    event = packet("event_high", met_s=5.0, event=10, occurrence=1, text="imu: gone")

    async def check(port):
        async with gateway(port, assets) as client, client.ws_connect("/stream") as socket:
            messages = await received(socket, lambda m: m["events"])
            found = messages[-1]["events"][0]
            assert (found["severity"], found["code"], found["text"]) == (
                "high",
                "PORT_LOST",
                "imu: gone",
            )
            old = await (await client.get("/history/events?start=0&end=1e15")).json()
            assert old[0]["code"] == "PORT_LOST"

    with FakeDaemon(stream=lambda: event) as daemon:
        asyncio.run(check(daemon.port))


def recorded(path, first_s: float, masses) -> None:
    """Write estimates, one a second on the machine's clock."""
    writer = RecordingWriter(path)
    for k, mass_kg in enumerate(masses):
        t_ns = round((first_s + k) * 1e9)
        body = {"mass_kg": mass_kg, "com_m": [0.0, 0.0, 0.5], "inertia_kg_m2": [1.0] * 6}
        sigma = {"mass_kg": 2.0, "com_m": [0.0] * 3, "inertia_kg_m2": [0.0] * 6}
        values = {"t_ns": t_ns, "valid": True, "nis": 70.0, "blocks": k}
        values |= {"estimate": {"target": body}, "sigma": {"target": sigma}}
        writer.json("/estimate", t_ns, values)
        writer.json("/events", t_ns, {"severity": "low", "code": "OLD", "text": str(k)})
    writer.close()


def test_history_comes_from_recordings_and_then_from_memory(assets, tmp_path):
    now_s = time.monotonic()
    recorded(tmp_path / "run.mcap", now_s - 60.0, range(300, 355))

    async def check(port):
        async with gateway(port, assets, tmp_path) as client:
            async with asyncio.timeout(20.0):
                while len(await (await client.get(f"/latest/{MASS}")).json()) == 0:
                    await asyncio.sleep(0.05)
            query = f"start={(time.time() - 300) * 1e3}&end={(time.time() + 5) * 1e3}"
            rows = await (await client.get(f"/history/{MASS}?{query}&size=5000")).json()
            old = [row for row in rows if row[1] == int(row[1])]
            assert [value for _, value in old] == list(range(300, 355))
            assert len(rows) > len(old), "and what came since"
            assert old[0][0] == pytest.approx(
                1e3 * (time.time() - time.monotonic() + now_s - 60.0), abs=50.0
            )
            assert rows == sorted(rows, key=lambda row: row[0])
            low = await (await client.get(f"/history/{MASS}_low?{query}")).json()
            assert low[0][1] == 298.0
            few = await (await client.get(f"/history/{MASS}?{query}&size=10")).json()
            assert 2 <= len(few) <= 12
            events = await (await client.get(f"/history/events?{query}")).json()
            assert [event["text"] for event in events if event["code"] == "OLD"] == list(
                map(str, range(55))
            )

    with FakeDaemon(stream=run_of_estimates()) as daemon:
        asyncio.run(check(daemon.port))


def test_events_of_a_recording_without_estimates_are_history_too(tmp_path):
    writer = RecordingWriter(tmp_path / "run.mcap")
    writer.json("/events", 5_000_000_000, {"severity": "low", "code": "OLD", "text": "alone"})
    writer.close()
    found = Recordings(tmp_path).events(0.0, 1e15, None)
    assert [event["text"] for event in found] == ["alone"]
    assert not len(Recordings(tmp_path).between("target_mass_kg", 0.0, 1e15, None))


def test_a_recording_that_is_being_written_or_broken_is_read_as_far_as_it_goes(tmp_path):
    from ground.gateway.history import read_recording

    recorded(tmp_path / "run.mcap", 100.0, range(300, 3300))
    whole = (tmp_path / "run.mcap").read_bytes()
    for size in (0, 5, 100, len(whole) // 2, len(whole) - 1):
        (tmp_path / "cut.mcap").write_bytes(whole[:size])
        found = read_recording(tmp_path / "cut.mcap")
        masses = found.columns.get("target_mass_kg", np.array([]))
        assert list(masses) == list(range(300, 300 + len(masses)))
        if size > len(whole) // 3:
            assert len(masses) > 500


def test_one_damaged_recording_takes_nothing_of_the_others(assets, tmp_path):
    recorded(tmp_path / "b.mcap", 100.0, range(300, 320))
    whole = (tmp_path / "b.mcap").read_bytes()
    damaged = bytearray(whole)
    damaged[len(whole) // 4] ^= 0xFF
    (tmp_path / "a.mcap").write_bytes(damaged)
    (tmp_path / "c.mcap").write_bytes(b"no recording at all")
    (tmp_path / "d.mcap").mkdir()
    for name, data in (("e", [1]), ("f", {"valid": None}), ("g", {"estimate": 5, "valid": 1})):
        writer = RecordingWriter(tmp_path / f"{name}.mcap")
        writer._add("/estimate", "json", 7, json.dumps(data).encode())
        writer._add("/estimate", "json", 8, b"[" * 100_000)
        writer._add("/events", "json", 9, b'{"severity": "low", "code": "X", "text": "x"}')
        writer.close()

    async def check():
        async with gateway(1, assets, tmp_path) as client:
            answer = await client.get(f"/history/{MASS}?start=0&end=1e15")
            assert answer.status == 200
            assert [mass for _, mass in await answer.json()] == list(range(300, 320))
            events = await (await client.get("/history/events?start=0&end=1e15")).json()
            assert [e["code"] for e in events].count("X") == 3
            events = await (await client.get("/history/events?start=0&end=1e15")).json()
            lines = [e["text"] for e in events if e["code"] == "RECORDING_DAMAGED"]
            assert sum("a.mcap: damaged" in line for line in lines) == 1, lines
            assert "c.mcap: not an MCAP file" in lines
            for name in ("e", "f", "g"):
                assert f"{name}.mcap: 2 messages with invalid content" in lines

    asyncio.run(check())


def test_memory_is_bounded_and_keeps_the_newest():
    ring = Ring(["a", "b"])
    for k in range(3 * MAX_ROWS):
        ring.add(float(k), {"a": float(k)})
    rows = ring.between("a", 0.0, 1e9)
    assert MAX_ROWS // 2 <= len(rows) <= 2 * MAX_ROWS
    assert rows[-1].tolist() == [3 * MAX_ROWS - 1.0] * 2
    assert np.all(np.isnan(ring.between("b", 0.0, 1e9)[:, 1]))


def test_thinning_keeps_the_extremes():
    t = np.arange(10_000.0)
    values = np.sin(t / 300.0)
    values[7777], values[1234] = 50.0, -50.0
    rows = thinned(np.column_stack((t, values)), 200)
    assert len(rows) <= 202
    assert max(rows, key=lambda row: row[1]) == (7777.0, 50.0)
    assert min(rows, key=lambda row: row[1]) == (1234.0, -50.0)
    assert rows == sorted(rows)


def test_what_a_page_says_wrongly_changes_nothing(assets):
    async def check(port):
        async with gateway(port, assets) as client, client.ws_connect("/stream") as socket:
            for text in ("{", "[]", '{"subscribe": 5}', '"x"', "{}", "[" * 100_000):
                await socket.send_str(text)
            await socket.send_bytes(b"\0")
            await socket.send_str(json.dumps({"subscribe": [MASS]}))
            await received(socket, lambda m: MASS in m["points"])
            assert socket.closed is False

    with FakeDaemon(stream=run_of_estimates()) as daemon:
        asyncio.run(check(daemon.port))


def test_subscriptions_are_those_of_points_that_exist():
    client, points = PageClient(), Points()
    many = [f"no.such{k}" for k in range(10_000)]
    _change_wanted(client, json.dumps({"subscribe": [MASS, *many]}), points)
    assert client.wanted == {MASS}
    _change_wanted(client, json.dumps({"unsubscribe": [MASS]}), points)
    assert not client.wanted


def test_packets_outside_the_dictionary_are_counted_and_the_reader_goes_on(assets):
    make = run_of_estimates()

    async def check(port):
        async with gateway(port, assets) as client, client.ws_connect("/stream") as socket:
            await socket.send_str(json.dumps({"subscribe": [MASS]}))
            await received(socket, lambda m: m.get("unknown", 0) > len(OUTSIDE))
            await received(socket, lambda m: MASS in m["points"])
            old = await (await client.get("/history/events?start=0&end=1e15")).json()
            told = [event["text"] for event in old if event["code"] == "UNKNOWN_PACKET"]
            assert len(told) == 4, "one of each kind; the set and the mode are of one kind"
            assert "apid 77" in told[0]
            assert OUTSIDE[0][:64].hex() in told[0]

    with FakeDaemon(stream=lambda: b"".join(OUTSIDE) + make()) as daemon:
        asyncio.run(check(daemon.port))


def test_played_back_packets_do_not_take_the_place_of_new_ones():
    """Before, an old packet was shown as the newest, and moved the clock of the page."""
    told = []
    feed = Feed("127.0.0.1", 1, Points(), lambda *parts: told.append(parts))
    feed._take(packet("health", met_s=5000.0, ticks=7))
    feed._take(packet("event_info", met_s=5000.0, text="new"))
    offset_ms = feed.offset_ms
    feed._take(packet("health", met_s=4000.0, ticks=6))
    feed._take(packet("event_info", met_s=4000.0, text="old"))
    feed._take(packet("event_info", met_s=4998.0, text="a little late"))
    assert feed.played_back == 2
    assert feed.latest["health"][1]["ticks"] == 7
    assert feed.offset_ms == pytest.approx(offset_ms, abs=100.0)
    assert [event["text"] for event in feed.events] == ["new", "a little late"]
    assert len(told) == 3


def test_a_reader_that_fails_says_so_and_connects_again(assets, monkeypatch):
    take, calls = Feed._take, []

    def failing(feed, raw):
        calls.append(raw)
        if len(calls) == 1:
            raise RuntimeError("a fault of the reader")
        take(feed, raw)

    monkeypatch.setattr(Feed, "_take", failing)

    async def check(port):
        async with gateway(port, assets) as client, client.ws_connect("/stream") as socket:
            await socket.send_str(json.dumps({"subscribe": [MASS]}))
            await received(socket, lambda m: MASS in m["points"])
            old = await (await client.get("/history/events?start=0&end=1e15")).json()
            assert "a fault of the reader" in str([e for e in old if e["code"] == "READER_FAILED"])

    with FakeDaemon(stream=run_of_estimates()) as daemon:
        asyncio.run(check(daemon.port))


def test_health_is_given_in_words_and_labels(assets):
    async def check():
        async with gateway(1, assets) as client:
            words = await (await client.get("/words")).json()
            assert words["bits"]["0"] == ["low", "slips"]
            assert words["bits"]["1"] == ["high", "port lost"]
            assert words["bits"]["14"] == ["high", "loop silent"]
            assert len(words["bits"]) == 21
            assert words["labels"]["health.mode"]["3"] == "IDENTIFY"
            assert words["may_command"] is False
            assert words["commands"] == []

    asyncio.run(check())


@pytest.mark.parametrize(
    ("message", "status"),
    [
        ({"name": "PING", "arguments": {}, "confirmed": False}, 400),
        ({"name": "PING", "arguments": {}}, 400),
        ({"name": "PING", "arguments": 5, "confirmed": True}, 400),
        ([], 400),
    ],
)
def test_a_command_that_is_not_confirmed_or_not_whole_is_not_sent(
    assets, tmp_path, message, status
):
    async def check(daemon):
        desk = Desk(lambda: Link("127.0.0.1", daemon.port, None), CommandHistory(tmp_path))
        async with commanding(daemon.port, assets, desk) as client:
            answer = await client.post("/command", json=message)
            assert answer.status == status
            wrong = await client.post("/command", data=json.dumps(message))
            assert wrong.status == 415
            assert not daemon.received

    with FakeDaemon() as daemon:
        asyncio.run(check(daemon))


def test_a_page_that_may_only_look_sends_nothing_and_another_site_never(assets, tmp_path):
    message = {"name": "PING", "arguments": {}, "confirmed": True}

    async def check(daemon):
        async with gateway(daemon.port, assets) as client:
            assert (await client.post("/command", json=message)).status == 403
        desk = Desk(lambda: Link("127.0.0.1", daemon.port, None), CommandHistory(tmp_path))
        async with commanding(daemon.port, assets, desk) as client:
            foreign = {"Origin": "http://evil.example"}
            assert (await client.post("/command", json=message, headers=foreign)).status == 403
            assert not daemon.received
            told = await (await client.post("/command", json=message)).json()
            assert told["outcome"] == "completed"
            wrong = message | {"name": "PNIG"}
            told = await (await client.post("/command", json=wrong)).json()
            assert "did you mean PING" in told["error"]

    with FakeDaemon() as daemon:
        asyncio.run(check(daemon))
    (line,) = CommandHistory(tmp_path).read(9)
    assert line["command"] == "PING"
    assert line["via"] == f"page, 127.0.0.1 ({getpass.getuser()})"


def test_a_page_that_may_command_needs_a_token(assets, tmp_path):
    message = {"name": "PING", "arguments": {}, "confirmed": True}

    async def check(daemon):
        desk = Desk(lambda: Link("127.0.0.1", daemon.port, None), CommandHistory(tmp_path))
        with pytest.raises(UsageError, match="needs a token"):
            application("127.0.0.1", daemon.port, assets, None, Guard("127.0.0.1"), desk=desk)
        async with commanding(daemon.port, assets, desk) as client:
            for given in ("", "Bearer", f"Bearer {TOKEN}x"):
                headers = {"Authorization": given}
                answer = await client.post("/command", json=message, headers=headers)
                assert answer.status == 401
        assert not daemon.received

    with FakeDaemon() as daemon:
        asyncio.run(check(daemon))


def test_the_address_that_serve_prints_lets_in_who_can_read_it(assets, tmp_path):
    with FakeDaemon() as daemon:
        command = [
            *(sys.executable, "-m", "ground", "--port", str(daemon.port)),
            *("--state", str(tmp_path), "serve", "--http-port", "0", "--command"),
            *("--assets", str(assets)),
        ]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as gateway:
            try:
                address = gateway.stdout.readline().strip()
                plain = address.partition("?")[0]
                with pytest.raises(urllib.error.HTTPError, match="401"):
                    urllib.request.urlopen(plain + "words")
                opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
                opener.open(address).close()
                assert json.load(opener.open(plain + "words"))["may_command"]
            finally:
                gateway.terminate()


def test_a_body_that_is_not_identified_has_no_values():
    points = Points()
    decoded = TelemetryDecoder().decode(packet("estimate", target_present=1, target_mass_kg=300.0))
    numbers = points.numbers(decoded)
    assert numbers["target_mass_kg"] == 300.0
    assert numbers["base_present"] == 0.0
    assert not any(name.startswith("base_") and name != "base_present" for name in numbers)
