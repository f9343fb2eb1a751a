"""State files whose place another thing has taken never hang or end the service."""

import json
import shutil

import pytest

from fsw.errors import ConfigError
from fsw.service.block_log import BlockLog
from fsw.service.blockstore import BlockWriter
from fsw.service.checkpoint_keeper import CheckpointKeeper
from fsw.service.status_file import StatusFile
from fsw.telemetry.link.sdls_keys import load_associations
from tests.support.application_cases import SECOND, Flight, flight_config
from tests.support.awkward_files import PLANTS, within
from tests.support.loop_cases import make_block
from tests.unit.fsw.telemetry.state.test_wrong_content import DEEP

LOGS = ("SECURITY_LOG_DUMP", "COMMAND_LOG_DUMP")
LATE_S = 20.0  # a busy machine; what hangs, hangs for ever


def fly(flight: Flight) -> None:
    """Run the application for a moment, with commands and an event that is stored."""
    flight.up()
    flight.send("PING")
    for name in LOGS:
        flight.send(name, {"entries": 9})
    flight.app.poll(flight.now + SECOND)
    flight.app.close()


@pytest.mark.parametrize("kind", PLANTS)
def test_whatever_lies_in_the_place_of_a_state_file_the_service_works(arm, kind):
    config = flight_config(arm)
    state = config.resolve(config.service.state_directory)
    fly(Flight(config))
    names = [path.relative_to(state) for path in state.rglob("*") if path.is_file()]
    names += [state / "status.json", state / "status.tmp", state / "checkpoint.0"]
    names += [state / "blocks.bin", state / "boot" / "new.tmp"]
    assert {"boot", "packet_stores"} <= {path.parts[0] for path in names}
    for name in names:
        place = state / name
        kept = place.read_bytes() if place.exists() else None
        place.unlink(missing_ok=True)
        PLANTS[kind](place)
        with within(LATE_S):
            flight = Flight(config)
            fly(flight)
            assert "alive" in [packet.packet.name for packet in flight.packets], name
            file = StatusFile(state)
            assert file.event_counts() == {}
            file.write({"event_counts": {}})
            keeper = CheckpointKeeper(config, state, lambda *_: None)
            keeper.adopt(1)
            BlockLog(state / "blocks.bin", 0, lambda *_: None).resume(lambda _: None)
        shutil.rmtree(place) if place.is_dir() and not place.is_symlink() else place.unlink(True)
        if kept is not None:
            place.write_bytes(kept)


@pytest.mark.parametrize("kind", PLANTS)
def test_whatever_lies_in_the_place_of_a_key_is_refused_at_once(arm, kind):
    sdls = {"keys": [{"spi": 1, "file": "a.key"}]}
    config = flight_config(arm, tc_security="sdls", sdls=sdls)
    PLANTS[kind](config.resolve(config.telemetry.sdls.keys[0].file))
    with within(LATE_S), pytest.raises(ConfigError, match=r"a\.key"):
        load_associations(config, config.telemetry.sdls, {})


@pytest.mark.parametrize(
    "content",
    [b"[1]", DEEP, b'{"event_counts": [1]}', b'{"event_counts": {"A": "x"}}', b"\xff", b"null"],
)
def test_a_status_file_of_wrong_content_counts_nothing(tmp_path, content):
    (tmp_path / "status.json").write_bytes(content)
    assert StatusFile(tmp_path).event_counts() == {}


@pytest.mark.parametrize("t_ns", ["1e999", "1" + "0" * 400, "NaN"])
def test_a_security_log_with_a_time_beyond_any_number_is_dumped_without_it(arm, t_ns):
    config = flight_config(arm)
    state = config.resolve(config.service.state_directory)
    state.mkdir()
    line = {"t_ns": 5, "severity": "high", "code": "TC_REFUSED", "text": "\ud800", "boot_count": 1}
    text = json.dumps(line)
    (state / "security.jsonl").write_text(f"{text.replace('5', t_ns, 1)}\n{text}\n")
    flight = Flight(config)
    flight.up()
    flight.send("SECURITY_LOG_DUMP", {"entries": 9})
    flight.app.poll(flight.now)
    assert [entry["time_s"] for entry in flight.all("event_log_entry")] == [5e-9]


def test_a_block_store_of_more_rows_than_any_is_no_store(tmp_path):
    path = tmp_path / "blocks.bin"
    BlockWriter(path, capacity=2).append(make_block(1))
    with path.open("r+b") as file:
        file.truncate(1 << 40)
    told = []
    BlockLog(path, 0, lambda *words: told.append(words)).resume(lambda _: None)
    assert told[0][1] == "BLOCKS_FAILED"
