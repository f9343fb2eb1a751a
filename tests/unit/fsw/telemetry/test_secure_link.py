"""The application behind authenticated frames: what is refused has no effect and is counted."""

from dataclasses import replace

import pytest

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import telecommand_packet
from tests.conftest import ArmProject
from tests.support.application_cases import DONE, Flight, flight_config
from tests.support.keys import write_key
from tests.support.sdls_sender import Sender, with_fecf

KEY = bytes(range(32))
SENDER = Sender(key=KEY, spi=1, virtual_channel=0)


@pytest.fixture
def config(arm: ArmProject):
    write_key(arm.folder / "uplink.key", KEY)
    keys = [{"spi": 1, "file": "uplink.key"}]
    return flight_config(arm, tc_security="sdls", sdls={"keys": keys, "window": 64})


class Secured:
    """A flight whose uplink takes bytes as the link gives them."""

    def __init__(self, config) -> None:
        self.flight = Flight(config)
        self.flight.up()
        self.uplink = self.flight.app.link.uplink(True)

    def take(self, data: bytes) -> list[str]:
        """Return the names of what came back."""
        before = len(self.flight.packets)
        for item in self.uplink.feed(data, self.flight.now):
            self.flight.app.receive(item, self.flight.now)
        return [p.packet.name for p in self.flight.packets[before:]]

    @property
    def counts(self) -> dict[str, int]:
        values = self.flight.app.values.of(8)
        return {name: values[f"sdls_{name}"] for name in ("accepted", "failed", "replayed")}


@pytest.fixture
def secured(config) -> Secured:
    return Secured(config)


def packet(name: str = "PING", sequence: int = 0, **values) -> bytes:
    return telecommand_packet(DICTIONARY.telecommand(name), values, sequence)


def test_an_authentic_frame_has_its_effect(secured):
    assert secured.take(SENDER.frame(packet(), 0)) == [*DONE[:2], "alive", DONE[2]]
    assert secured.counts == {"accepted": 1, "failed": 0, "replayed": 0}


def test_a_replay_is_told_with_the_number_that_is_taken_next(secured):
    frame = SENDER.frame(packet(), 6)
    secured.take(frame)
    told = secured.take(frame)
    assert told[0] == "acceptance_failure"
    failure = secured.flight.last("acceptance_failure")
    assert (failure["error"], failure["error_value"]) == (Error.REPLAY, 7.0)
    assert secured.counts == {"accepted": 1, "failed": 0, "replayed": 1}
    assert len(secured.flight.all("alive")) == 1


def test_a_number_too_far_ahead_is_refused(secured):
    assert "alive" not in secured.take(SENDER.frame(packet(), 64))
    assert secured.flight.error() is Error.REPLAY


@pytest.mark.parametrize(
    "change", [{"key": KEY[::-1]}, {"spi": 2}, {"virtual_channel": 1}], ids=str
)
def test_a_stranger_is_refused(secured, change):
    assert "alive" not in secured.take(replace(SENDER, **change).frame(packet(), 0))
    assert secured.counts["accepted"] == 0


def test_a_telecommand_in_clear_is_refused(secured):
    told = secured.take(packet())
    assert told[0] == "acceptance_failure"
    assert secured.flight.error() is Error.NOT_AUTHENTICATED
    assert secured.counts == {"accepted": 0, "failed": 1, "replayed": 0}


def test_no_tampered_byte_gets_through(secured):
    frame = SENDER.frame(packet("SET_MODE", mode=1), 0)
    mode = secured.flight.app.mode_machine.mode
    for at in range(len(frame) - 2):
        spoiled = bytearray(frame[:-2])
        spoiled[at] ^= 0x10
        secured.take(with_fecf(bytes(spoiled)) + bytes(1024))
    assert secured.counts["accepted"] == 0
    assert secured.flight.app.mode_machine.mode is mode
    assert secured.take(SENDER.frame(packet(), 0))[0] == "acceptance_success"


def test_frames_of_the_last_run_are_refused_in_the_next(config):
    first = Secured(config)
    frames = [SENDER.frame(packet(sequence=k), k) for k in range(5)]
    for frame in frames:
        first.take(frame)
    crashed = Secured(config)  # nothing was closed
    for frame in frames:
        crashed.take(frame)
    assert crashed.flight.all("alive") == []
    number = int(crashed.flight.last("acceptance_failure")["error_value"])
    assert "alive" in crashed.take(SENDER.frame(packet(), number))


def test_a_whole_packet_must_be_in_the_frame(secured):
    secured.take(SENDER.frame(packet()[:-3], 0))
    assert secured.flight.error() is Error.BAD_LENGTH
    assert secured.flight.all("alive") == []


def test_several_packets_may_share_a_frame(secured):
    secured.take(SENDER.frame(packet(sequence=1) + packet(sequence=2), 0))
    assert len(secured.flight.all("alive")) == 2
