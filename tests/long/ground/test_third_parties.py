"""Clients nobody here wrote, against the running daemon in a real-time run of the bench.

One run serves all tests of this file, in their order; the last ones read what it left behind.
"""

import io
import json
import os
import subprocess
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fsw.telemetry.dictionary import DICTIONARY, Type
from ground.commands import Catalogue
from ground.dictionary import XTCE
from ground.link import Link
from ground.telemetry import TelemetryDecoder, apid, split
from tests.support.daemon_log import DaemonLog
from tests.support.live_run import LiveRun, ground
from tests.support.packet_checks import CHECKS, NEVER_SENT
from tests.support.tool import run_tool
from tests.support.tour import Tour

pytestmark = pytest.mark.timeout(900)  # a busy machine starts the daemon slowly

TMTCCMD = Path(sys.prefix) / "tmtccmd" / "bin" / "python"
OPENC3 = Path(sys.prefix) / "openc3" / "bin" / "python"
FILE_BYTES = 250_000
LOSS, SEED = 0.01, 3


@pytest.fixture(scope="module")
def live(tmp_path_factory) -> Iterator[LiveRun]:
    run = LiveRun(tmp_path_factory.mktemp("live"))
    yield run
    run.close()


def test_tmtccmd_pings_and_sees_the_whole_verification_chain(live):
    if not TMTCCMD.exists():
        pytest.skip("needs tmtccmd in an environment of its own: sh tests/setup --all")
    script = Path(__file__).parents[2] / "support" / "tmtccmd_ping.py"
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [TMTCCMD, script, str(live.port)],
        capture_output=True,
        text=True,
        timeout=150,
        check=False,
        env=clean,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["alive"]
    assert found["completed"]
    assert (found["accepted"], found["ended"]) == ("SUCCESS", "SUCCESS")
    assert {1, 7} <= set(found["stages"])
    assert found["others"] > 0, "telemetry of other services goes by"


def test_openc3_sends_commands_by_the_export_and_sees_them_verified(live):
    found = run_tool(OPENC3, "openc3_client.py", XTCE.parent / "cosmos", live.port, timeout_s=400.0)
    ping, report, refused = found["sent"]
    chain = ["ACCEPTANCE_SUCCESS", "START_SUCCESS", "COMPLETION_SUCCESS"]
    assert (ping["reports"], report["reports"]) == (chain, chain)
    assert "ALIVE" in ping["seen"]
    assert "HEALTH" in report["seen"]
    assert refused["reports"] == ["ACCEPTANCE_FAILURE"]  # data of a table that is not loading


def test_librecube_gets_a_file_byte_by_byte_with_one_percent_of_the_units_lost(live, tmp_path):
    cfdp = pytest.importorskip("cfdp", reason="needs cfdp (LibreCube): sh tests/setup --all")
    from cfdp.filestore import NativeFileStore
    from cfdp.transport.base import Transport

    from ground.delivery import Delivery

    data = np.random.default_rng(SEED).bytes(FILE_BYTES)
    (live.state / "files" / "down.bin").write_bytes(data)
    rng = np.random.default_rng(SEED)
    lost: Counter[str] = Counter()
    link = Link("127.0.0.1", live.port, None)
    catalogue = Catalogue()
    wrap = Delivery(link, catalogue, TelemetryDecoder(), 60.0, lambda _text: None)._wrapped

    class LossyLink(Transport):
        def request(self, pdu: bytes) -> None:
            if rng.random() < LOSS:
                lost["up"] += 1
            else:
                link.send(wrap(bytes(pdu)))

    transport = LossyLink()
    entity = cfdp.CfdpEntity(
        entity_id=2,
        filestore=NativeFileStore(str(tmp_path)),
        transport=transport,
        nak_timer_interval=1.0,
        nak_timer_expiration_limit=1000,
        transaction_inactivity_limit=1000,
    )
    finished: list[object] = []
    entity.transaction_finished_indication_required = True
    entity.transaction_finished_indication = lambda *arguments, **_words: finished.append(arguments)
    try:
        given = {"path": "files/down.bin", "remove": "NO"}
        link.send(catalogue.build("DOWNLINK_FILE", given, link.next_sequence()))
        until_s = time.monotonic() + 180.0
        for packet in link.packets(until_s):
            if apid(packet) == 101:
                if rng.random() < LOSS:
                    lost["down"] += 1
                else:
                    transport.indication(packet[6:])
            if finished:
                break
    finally:
        entity.shutdown()
        entity._event_thread.join()
        entity._message_thread.join()
        link.close()
    assert lost["down"] >= 1
    assert (tmp_path / "down.bin").read_bytes() == data


def test_the_ground_command_commands_and_tells_what_became_of_it(live):
    done = ground(live, "tc", "PING")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "acceptance success" in done.stdout
    assert "alive" in done.stdout
    version = json.loads(ground(live, "tc", "REPORT_VERSION", "--json").stdout)
    assert version["completed"]
    assert version["answers"][0]["packet"] == "version"
    refused = ground(live, "tc", "SET_INTERVAL", "sid=HEALTH", "interval_ms=1", "--force")
    assert refused.returncode == 3
    assert "OUT_OF_RANGE, argument 3" in refused.stdout
    both = ("batch_last_s=30", "time_report_exponent=3")
    assert ground(live, "tc", "SET_PARAMETERS", *both).returncode == 0
    told = json.loads(
        ground(live, "tc", "REPORT_PARAMETERS", "parameter=batch_last_s", "--json").stdout
    )
    assert told["answers"][0]["values"]["batch_last_s"] == 30.0


def test_the_ground_command_shows_telemetry(live):
    done = ground(live, "tm", "estimate", "--count", "3", "--seconds", "120", "--json")
    assert done.returncode == 0, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(found) == 3
    assert all(item["values"]["method"] == "FUSED" for item in found)


def test_the_ground_command_brings_files_both_ways(live, tmp_path):
    data = np.random.default_rng(9).bytes(100_000)
    (tmp_path / "up.bin").write_bytes(data)
    put = ground(live, "file", "put", str(tmp_path / "up.bin"))
    assert put.returncode == 0, put.stderr
    assert (live.state / "files" / "up.bin").read_bytes() == data
    got = ground(live, "file", "get", "files/up.bin", str(tmp_path / "back.bin"))
    assert got.returncode == 0, got.stderr
    assert (tmp_path / "back.bin").read_bytes() == data
    listed = ground(live, "file", "list", "files")
    assert "100000  files/up.bin" in listed.stdout
    missing = ground(live, "file", "get", "files/nothing")
    assert missing.returncode == 3
    told = (live.state / "events.jsonl").read_text()
    assert told.count('"FILE_SENT"') == 2  # LibreCube's, and this one: the daemon knows


def test_a_client_goes_through_all_services(live):
    tour = Tour(live)
    try:
        tour.go()
    finally:
        tour.close()
    live.kept = tour.kept


# what is left behind


@pytest.fixture(scope="module")
def packets(live) -> list[bytes]:
    live.stop_daemon()
    (live.folder / "stream.bin").write_bytes(live.raw)
    buffer = bytearray(live.raw)
    found = list(split(buffer))
    assert not buffer, "the stream ends with a whole packet"
    assert len(found) > 100
    return found


def test_space_packet_parser_decodes_every_packet_with_the_values_of_the_daemons_own_log(
    live, packets
):
    spp = pytest.importorskip("space_packet_parser", reason="needs space_packet_parser")
    definition, decoder, log = spp.load_xtce(XTCE), TelemetryDecoder(), DaemonLog(live)
    compared: Counter[str] = Counter()
    wrong: dict[str, object] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for raw in packets:
            if apid(raw) == 101:
                continue  # what is in it is file delivery's own
            definition.parse_bytes(raw)  # without a warning
            sample = decoder.decode(raw)
            if not CHECKS[sample.packet](sample, log):
                wrong[sample.packet] = sample
            compared[sample.packet] += 1
    assert wrong == {}
    known = {packet.name for packet in DICTIONARY.packets}
    assert set(compared) == known - NEVER_SENT
    assert compared["estimate"] > 5


def test_the_last_counters_are_those_of_the_daemons_last_summary(live, packets):
    decoder, final = TelemetryDecoder(), live.status()["telemetry"]
    last = {s.packet: s.values for s in map(decoder.decode, packets) if s is not None}
    for name in ("tc_bytes", "tc_garbage_bytes", "tc_resyncs", "udp_dropped", "tm_dropped"):
        assert last["link"][name] == final["link"][name]
    assert last["link"]["tc_packets"] == final["tc"]["tc_packets"]
    for name in ("tc_accepted", "tc_rejected", "tc_completed", "tc_failed"):
        assert last["health"][name] == final["tc"][name]


def test_ccsdspy_decodes_the_stored_stream_in_bulk(packets):
    ccsdspy = pytest.importorskip("ccsdspy", reason="needs ccsdspy: sh tests/setup --all")
    decoder = TelemetryDecoder()
    streams: dict[str, list[bytes]] = {}
    for raw in packets:
        if apid(raw) != 101:
            sample = decoder.decode(raw)
            assert sample is not None
            streams.setdefault(sample.packet, []).append(raw)
    assert {"health", "estimate", "science", "time", "link", "devices"} <= set(streams)
    for name, raws in streams.items():
        packet = DICTIONARY.packet(name)
        table = ccsdspy.FixedLength.from_file(str(XTCE.parent / "ccsdspy" / f"{name}.csv"))
        found = table.load(io.BytesIO(b"".join(raws)))
        last = decoder.decode(raws[-1])
        assert last is not None
        for item in packet.fields:
            assert len(found[item.name]) == len(raws)
            if item.name in last.values and item.enumeration is None and item.type is not Type.TEXT:
                assert found[item.name][-1] == last.values[item.name], f"{name}.{item.name}"
