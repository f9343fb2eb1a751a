"""A disk that is full, cannot be written or is gone takes no telecommand from the ground."""

import shutil

import pytest

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error, Health, Mode
from fsw.telemetry.link.packets import telecommand_packet
from fsw.telemetry.link.sdls import RANDOM_BITS
from fsw.telemetry.state.epoch import Epoch
from tests.conftest import ArmProject
from tests.support.application_cases import SECOND, Flight, flight_config
from tests.support.keys import write_key
from tests.support.sdls_sender import Sender
from tests.support.small_disk import fill, read_only, small_disk, use_up_inodes

COMMAND, TELEMETRY = bytes(range(32)), bytes(range(32, 64))
SENDER = Sender(key=COMMAND, spi=1, virtual_channel=0)
IV_AT = 7 + 2
ROOM_BYTES = 1 << 20
RESCUING = [
    ("PING", {}),
    ("REPORT_FREE_SPACE", {}),
    ("LIST_FILES", {"path": "files", "first": 1}),
    ("DELETE_FILE", {"path": "files/old"}),
    ("REC_STOP", {}),
    ("SET_MODE", {"mode": int(Mode.SAFE)}),
]


class Link:
    """A flight with keys whose state lies on a disk of its own."""

    def __init__(self, arm: ArmProject, disk, *, utc_s: int = 1_800_000_000) -> None:
        for name, key in (("command.key", COMMAND), ("telemetry.key", TELEMETRY)):
            write_key(arm.folder / name, key)
        slots = [
            {"spi": 1, "file": "command.key"},
            {"spi": 2, "file": "telemetry.key", "role": "telemetry"},
        ]
        arm.data["service"]["state_directory"] = str(disk / "state")
        config = flight_config(arm, tc_security="sdls", port=0, sdls={"keys": slots, "window": 64})
        epoch = Epoch(clock_id="first", utc_less_met_ns=(utc_s - 1000) * SECOND)
        self.flight = Flight(config, epoch=epoch)
        self.flight.app.link.security.open()
        self.flight.recording.on = True
        self.flight.up()
        self._uplink = self.flight.app.link.uplink(True)

    def send(self, name: str, number: int, **values) -> list[str]:
        """Send a telecommand under a number; return the names of what came back."""
        before = len(self.flight.packets)
        packet = telecommand_packet(DICTIONARY.telecommand(name), values, number & 0x3FFF)
        for item in self._uplink.feed(SENDER.frame(packet, number, 7), self.flight.now):
            self.flight.app.receive(item, self.flight.now)
        self.flight.app.poll(self.flight.now)
        return [p.packet.name for p in self.flight.packets[before:]]

    def sealed_number(self) -> int:
        frame = self.flight.app.link.security.seal(bytes(20))
        return int.from_bytes(frame[IV_AT : IV_AT + 6], "big")


@pytest.fixture
def disk(tmp_path):
    with small_disk(tmp_path / "disk", ROOM_BYTES, 200) as folder:
        yield folder


@pytest.mark.parametrize("spoil", [fill, use_up_inodes])
def test_a_full_disk_takes_no_telecommand_away(arm, disk, spoil):
    link = Link(arm, disk)
    (disk / "state" / "files" / "old").write_bytes(b"1")
    spoil(disk)
    for number in range(100):
        assert "alive" in link.send("PING", number), number
    for number, (name, values) in enumerate(RESCUING, start=100):
        assert "completion_success" in link.send(name, number, **values), name
    assert not (disk / "state" / "files" / "old").exists()
    assert "TC_NOT_KEPT" not in link.flight.codes


def test_what_frees_space_is_accepted_though_no_number_can_be_kept(arm, disk):
    link = Link(arm, disk)
    (disk / "state" / "files" / "old").write_bytes(b"1")
    assert "alive" in link.send("PING", 0)
    read_only(disk)
    told = [name for number in range(1, 30) for name in link.send("RESET_COUNTERS", number)]
    assert "acceptance_failure" in told
    assert link.flight.error() is Error.NOT_KEPT
    assert "TC_NOT_KEPT" in link.flight.codes
    assert link.flight.app.supervision.health.latched >> Health.SECURITY & 1
    for number, (name, values) in enumerate(RESCUING, start=30):
        assert "acceptance_success" in link.send(name, number, **values), name
    assert "acceptance_success" not in link.send("SET_MODE", 40, mode=int(Mode.STANDBY))
    again = link.send("PING", 30)
    assert "alive" not in again, "a number was accepted twice"
    read_only(disk, on=False)
    assert "completion_success" in link.send("RESET_COUNTERS", 41)


def test_a_state_directory_that_is_gone_is_made_again_for_the_numbers(arm, disk):
    link = Link(arm, disk)
    assert "alive" in link.send("PING", 0)
    shutil.rmtree(disk / "state")
    for number in range(1, 40):
        assert "alive" in link.send("PING", number), number
    restarted = Link(arm, disk)
    assert "alive" not in restarted.send("PING", 39)
    assert "alive" in restarted.send("PING", 60)


@pytest.mark.parametrize("clock_back_s", [0, 100_000_000])
def test_numbers_of_telemetry_rise_over_a_restart_on_a_full_disk(arm, disk, clock_back_s):
    before = Link(arm, disk)
    fill(disk)
    sealed = [before.sealed_number() for _ in range(3)]
    after = Link(arm, disk, utc_s=1_800_000_000 + 1 - clock_back_s)
    assert after.sealed_number() > sealed[-1]


def test_numbers_of_telemetry_rise_though_none_was_ever_kept(arm, disk):
    (disk / "state").mkdir()
    first = Link(arm, disk)
    (disk / "state" / "uplink_numbers").unlink()
    read_only(disk)
    before = Link(arm, disk, utc_s=1_800_000_010)
    numbers = [before.sealed_number() for _ in range(1000)]
    assert numbers == sorted(set(numbers))
    assert numbers[0] > first.sealed_number()
    after = Link(arm, disk, utc_s=1_800_000_011)
    assert after.sealed_number() > numbers[-1]
    assert "TM_NUMBERS_FAILED" in after.flight.codes
    assert after.flight.codes.count("TM_NUMBERS_FAILED") == 1


@pytest.mark.parametrize("utc_s", [0, -(10**9), 9 * 10**9])
def test_a_clock_that_is_wrong_leaves_numbers_enough(arm, disk, utc_s):
    link = Link(arm, disk, utc_s=utc_s)
    first = link.sealed_number()
    assert 0 <= first < 1 << (RANDOM_BITS - 1)
    assert link.sealed_number() == first + 1


def test_a_change_of_keys_repeats_no_number(arm, disk):
    link = Link(arm, disk)
    numbers = [link.sealed_number() for _ in range(5)]
    link.flight.app.link.security.load_keys()
    numbers += [link.sealed_number() for _ in range(5)]
    assert numbers == sorted(set(numbers))
