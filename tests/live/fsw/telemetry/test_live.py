"""The daemon as real processes, commanded over TCP."""

import socket
from contextlib import suppress

from fsw.telemetry.link.packets import Telemetry
from tests.conftest import ArmProject
from tests.support.live_daemon import running


def test_a_daemon_is_commanded_over_its_link_and_starts_again_when_told(arm: ArmProject):
    with running(arm) as run:
        ground = run.connect()
        ground.mode("IDENTIFY")
        assert ground.tell("PING") == "completion_success"
        assert any(told.packet.name == "alive" for told in ground.seen)
        assert ground.tell("SETTLE_ESTIMATOR") == "completion_success"
        assert ground.tell("REC_STOP") == "completion_success"
        assert ground.wait("recorder").values["recording"] == 0
        assert ground.tell("REC_START") == "completion_success"
        ground.send("ENABLE_SET", {"sid": 20})
        assert ground.wait("science").packet.apid == 102
        assert ground.tell("RUN_BATCH", {"method": "FUSED", "unknown": 0, "last_s": 0.0}) == (
            "completion_failure"  # no window yet
        )
        asked = {"duration_s": 20.0, "starts": 1, "seed": 0}
        assert ground.tell("RUN_PLAN", asked) == "completion_failure"  # no limits configured
        assert ground.tell("SET_MODE", {"mode": "STANDBY"}) == "completion_success"
        ground.mode("STANDBY")
        before = ground.wait("link").values["boot_count"]
        assert ground.tell("RESTART", {"key": 0xB007}) == "completion_success"
        ground.drain()
        again = run.connect()
        told = again.mode("STANDBY").values  # as it was
        assert (told["boot_count"], told["reset_cause"]) == (before + 1, 2)
        assert run.end() == 0


def test_a_client_that_does_not_read_costs_itself_packets_and_the_loop_nothing(arm: ArmProject):
    with (
        running(arm, queue_bytes=65536, science_interval_s=0.01) as run,
        socket.socket() as stuck,
    ):
        ground = run.connect()
        ground.mode("IDENTIFY")
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 15)  # less: 2 kB each 0.2 s
        stuck.connect(("127.0.0.1", run.port))
        ground.until("drops", lambda told: of_link(told, "tm_dropped") > 100)
        assert ground.tell("PING") == "completion_success"
        ticks = ground.wait("health").values["ticks"]
        ground.until("ticks", lambda told: of_health(told, "ticks") > ticks)
        stuck.setblocking(False)

        def told_of_drops(told: Telemetry) -> bool:
            with suppress(BlockingIOError):
                while stuck.recv(1 << 16):
                    pass
            text = str(told.values.get("text", ""))
            return told.packet.name == "event_info" and "packets were dropped" in text

        ground.until("LINK_CAUGHT_UP", told_of_drops)
        assert any("is slow" in str(told.values.get("text", "")) for told in ground.seen)


def of_link(told: Telemetry, name: str) -> float:
    return float(told.values[name]) if told.packet.name == "link" else 0.0


def of_health(told: Telemetry, name: str) -> float:
    return float(told.values[name]) if told.packet.name == "health" else 0.0
