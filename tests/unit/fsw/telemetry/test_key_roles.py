"""Keys: their roles, their change without a restart, and the sealed telemetry of the link."""

import pytest
from pydantic import ValidationError

from fsw.config.sdls import SdlsConfig
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import telecommand_packet, uplink_file_packet
from ground.downlink import FrameStream
from tests.conftest import ArmProject
from tests.support.application_cases import DONE, Flight, flight_config
from tests.support.keys import write_key
from tests.support.sdls_sender import Sender

COMMAND, SPARE, LOOK, TELEMETRY = (bytes(range(k, k + 32)) for k in (0, 40, 80, 120))
NAMES = {"command.key": COMMAND, "spare.key": SPARE, "look.key": LOOK, "tm.key": TELEMETRY}
KEYS = [
    {"spi": 1, "file": "command.key"},
    {"spi": 3, "file": "spare.key"},
    {"spi": 5, "file": "look.key", "role": "look"},
    {"spi": 2, "file": "tm.key", "role": "telemetry"},
]


class Operator:
    """A flight, and frames under several keys."""

    def __init__(self, arm: ArmProject) -> None:
        for name, key in NAMES.items():
            write_key(arm.folder / name, key)
        config = flight_config(arm, tc_security="sdls", sdls={"keys": KEYS, "window": 64})
        self.flight = Flight(config)
        self.flight.up()
        self._uplink = self.flight.app.link.uplink(True)
        self._numbers: dict[bytes, int] = {}

    def packet(self, name: str, **values) -> bytes:
        return telecommand_packet(DICTIONARY.telecommand(name), values, len(self.flight.packets))

    def send(self, packet: bytes, key: bytes, spi: int) -> list[str]:
        """Send a packet under a key; return the names of what came back."""
        before = len(self.flight.packets)
        number = self._numbers[key] = self._numbers.get(key, -1) + 1
        frame = Sender(key=key, spi=spi, virtual_channel=0).frame(packet, number, 7)
        for item in self._uplink.feed(frame, self.flight.now):
            self.flight.app.receive(item, self.flight.now)
        return [p.packet.name for p in self.flight.packets[before:]]

    def ping(self, key: bytes = COMMAND, spi: int = 1) -> bool:
        return "alive" in self.send(self.packet("PING"), key, spi)

    def load_keys(self, key: bytes = SPARE, spi: int = 3) -> list[str]:
        return self.send(self.packet("LOAD_KEYS"), key, spi)


@pytest.fixture
def operator(arm: ArmProject) -> Operator:
    return Operator(arm)


@pytest.mark.parametrize("name", ["PING", "CLEAR_HEALTH", "LOAD_KEYS", "REC_START"])
def test_who_may_only_look_commands_nothing_and_it_is_counted_and_reported(operator, name):
    flight = operator.flight
    told = operator.send(operator.packet(name, mask=0), LOOK, 5)
    assert told[0] == "acceptance_failure"
    assert "acceptance_success" not in told
    assert flight.error() is Error.NOT_AUTHORISED
    assert flight.commands == []
    assert flight.codes.count("TC_NOT_AUTHORISED") == 1
    flight.app.housekeeping.report(8)
    assert flight.last("link")["tc_not_authorised"] == 1
    flight.app.housekeeping.report(1)
    assert flight.last("health")["health"] >> 19 & 1, "security"
    assert operator.ping()


def test_who_may_only_look_sends_no_file(operator):
    operator.send(uplink_file_packet(bytes(20), 1), LOOK, 5)
    assert operator.flight.error() is Error.NOT_AUTHORISED
    assert operator.flight.app.transfers.delivery.counters()["pdus_received"] == 0


def test_the_key_of_telemetry_commands_nothing(operator):
    operator.send(operator.packet("PING"), TELEMETRY, 2)
    assert operator.flight.app.link.security.receiver.accepted == 0
    assert operator.flight.all("alive") == []


def test_a_key_is_changed_without_a_restart(operator, arm):
    assert operator.ping()
    assert operator.ping(SPARE, 3)
    fresh = bytes(range(200, 232))
    write_key(arm.folder / "command.key", fresh)
    assert operator.ping(), "a file alone changes nothing"
    assert operator.load_keys()[-1] == DONE[2]
    assert not operator.ping()
    assert operator.ping(fresh, 1)
    assert operator.ping(SPARE, 3)
    assert operator.flight.codes.count("KEYS_LOADED") == 1
    text = next(e.text for e in operator.flight.events if e.code == "KEYS_LOADED")
    assert text == "SPI 1 command, SPI 3 command, SPI 5 look, SPI 2 telemetry"


@pytest.mark.parametrize("fault", ["short", "open", "gone", "twice"])
def test_keys_that_cannot_be_used_leave_the_old_ones(operator, arm, fault):
    write_key(arm.folder / "command.key", {"short": bytes(31), "twice": LOOK}.get(fault, bytes(32)))
    if fault == "open":
        (arm.folder / "command.key").chmod(0o644)
    if fault == "gone":
        (arm.folder / "command.key").unlink()
    assert "completion_failure" in operator.load_keys()
    assert operator.flight.error() is Error.FAILED
    assert operator.ping()
    assert operator.ping(SPARE, 3)


def test_a_replaced_key_that_comes_back_accepts_no_old_frame(operator, arm):
    ping = operator.packet("PING")
    assert "alive" in operator.send(ping, COMMAND, 1)
    write_key(arm.folder / "command.key", bytes(32))
    operator.load_keys()
    write_key(arm.folder / "command.key", COMMAND)
    operator.load_keys()
    frame = Sender(key=COMMAND, spi=1, virtual_channel=0).frame(ping, 0, 7)
    receiver = operator.flight.app.link.security.receiver
    assert receiver.receive(frame).reason == "REPLAY"


def test_telemetry_is_sealed_and_its_key_changes_with_the_others(operator, arm):
    seal = operator.flight.app.link.security.seal
    options = {"spi": 2, "spacecraft_id": 42, "virtual_channel": 0}
    stream = FrameStream(arm.folder / "tm.key", arm.folder / "ground", **options)
    for key in (TELEMETRY, bytes(32)):
        write_key(arm.folder / "tm.key", key)
        operator.load_keys()
        stream.add(seal(operator.flight.raw[-1]))
        assert list(stream.packets()) == [operator.flight.raw[-1]]


def test_in_clear_there_are_no_keys_to_load(arm):
    flight = Flight(flight_config(arm))
    flight.up()
    assert flight.refused("LOAD_KEYS") is Error.NOT_SUPPORTED


def test_a_daemon_that_is_quiet_gives_back_the_numbers_it_keeps_ahead(operator, arm):
    operator.ping()
    operator.flight.wait(3.0)
    again = Operator(arm)  # the first one crashed
    again._numbers = operator._numbers
    assert again.ping(), "no number was skipped"


@pytest.mark.parametrize(
    ("roles", "words"),
    [
        (["look"], "0 of 'command'"),
        (["command"] * 3, "3 of 'command'"),
        (["command", "telemetry", "telemetry"], "2 of 'telemetry'"),
        (["command", "admin"], "'command', 'look' or 'telemetry'"),
    ],
)
def test_slots_of_each_role_are_bounded(roles, words):
    keys = [{"spi": k, "file": f"{k}.key", "role": role} for k, role in enumerate(roles, 1)]
    with pytest.raises(ValidationError, match=words):
        SdlsConfig.model_validate({"keys": keys})
