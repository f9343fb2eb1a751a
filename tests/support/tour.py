"""Telecommands that make the daemon send every packet it can, and what must be in the answers."""

import binascii
import json
import struct
import time
import zlib
from typing import Any

from fsw.telemetry.dictionary import DICTIONARY
from ground.commands import Catalogue
from ground.link import Link
from ground.telemetry import Sample, TelemetryDecoder
from ground.verification import Verification, VerificationOutcome, follow
from tests.support.live_run import LiveRun

PATIENCE_S = 400.0  # a batch worker of low priority compiles first, beside all other tests
MONITOR = {"id": 9, "value": "link.clients", "low": 1000.0, "repetitions": 1, "stale_s": 60.5}
MONITORS = json.dumps({"monitors": [MONITOR | {"action": "abort_batch"}]}).encode()  # is YAML too
LATER_S = 5000.0
WHOLE_RUN_S = "3600"  # of blocks: on a busy machine the motion can be over for a while
DELAY_MS = 600_000  # after the first entry of the sequence: it is aborted before
PARAMETERS = [item.name for item in DICTIONARY.parameters]


class Tour:
    """One client that goes through all services."""

    def __init__(self, run: LiveRun) -> None:
        self._link = Link("127.0.0.1", run.port, None)
        self._catalogue, self._decoder = Catalogue(), TelemetryDecoder()
        (run.state / "files" / "tour.bin").write_bytes(bytes(range(200)))
        self.kept: dict[str, Any] = {}  # telecommands kept on board, as they must be reported

    def close(self) -> None:
        self._link.close()

    def tell(self, name: str, **given: str) -> Verification:
        """Give a telecommand and follow it to its end."""
        packet = self._catalogue.build(name, given, self._link.next_sequence())
        return self._follow(packet)

    def _follow(self, packet: bytes) -> Verification:
        *_, (verification, _) = follow(self._link, self._decoder, packet, PATIENCE_S)
        return verification

    def do(self, name: str, **given: str) -> None:
        told = self.tell(name, **given)
        reports = [report.values for report in told.reports]
        assert told.outcome is VerificationOutcome.COMPLETED, (name, told.outcome, reports)

    def wait(self, name: str) -> Sample:
        """Read until a packet of this name comes."""
        for raw in self._link.packets(time.monotonic() + PATIENCE_S):
            sample = self._decoder.decode(raw)
            if sample is not None and sample.packet == name:
                return sample
        raise TimeoutError(name)

    def go(self) -> None:
        """Go through all."""
        while not self.wait("estimate").values["blocks"]:
            pass  # there is no diagnosis before the first block
        self._reports()
        self._schedule()
        self._onboard()
        self._refusals()
        while self.wait("estimate").values["valid"] != "YES":
            pass  # a batch on too little motion ends in INSUFFICIENT_EXCITATION
        self.do("RUN_BATCH", method="FUSED", unknown="TARGET", last_s=WHOLE_RUN_S)
        self.wait("batch")
        self._monitors()

    def _status(self) -> str:
        """How the one monitor stands."""
        told = self.tell("REPORT_MONITOR_STATUS").answers
        return next(str(s.values["status"]) for s in told if s.packet == "monitor_status")

    def _reports(self) -> None:
        for name in ("PING", "REPORT_VERSION", "REPORT_DIAGNOSIS"):
            self.do(name)
        self.do("REPORT_SET_PROPERTIES", sid="HEALTH")
        self.do("DISABLE_EVENT", event="BATCH_DONE")
        self.do("REPORT_DISABLED_EVENTS")
        self.do("ENABLE_EVENT", event="BATCH_DONE")
        self.do("EVENT_LOG_DUMP", entries="50")
        self.do("SET_TIME_REPORT_RATE", exponent="0")
        for name in PARAMETERS:
            self.do("REPORT_PARAMETERS", parameter=name)
        self.do("COPY_FILE", path="files/tour.bin", target="files/copy.bin")
        self.do("LIST_FILES", path="files", first="1")
        self.do("REPORT_FILE_ATTRIBUTES", path="files/copy.bin")
        self.do("CREATE_DIRECTORY", path="files/tour")
        self.do("COPY_FILE", path="files/tour.bin", target="files/moving.bin")
        self.do("MOVE_FILE", path="files/moving.bin", target="files/tour/moved.bin")
        self.do("RENAME_DIRECTORY", path="files/tour", target="files/toured")
        self.do("DELETE_FILE", path="files/toured/moved.bin")
        self.do("DELETE_DIRECTORY", path="files/toured")
        self.do("REPORT_TRANSFERS")
        self.do("REPORT_FREE_SPACE")

    def _schedule(self) -> None:
        release_s = self.wait("health").time_s // 1 + LATER_S
        ping = self._catalogue.build("PING", {}, self._link.next_sequence())
        packet = self._catalogue.at(ping, release_s, self._link.next_sequence())
        assert self._follow(packet).outcome is VerificationOutcome.COMPLETED
        count = int.from_bytes(ping[2:4], "big") & 0x3FFF
        entry = {"source_id": 0, "apid": 100, "sequence_count": count}
        entry |= {"release_time_s": release_s, "service": 17, "subtype": 1}
        self.kept |= {"schedule": entry, "scheduled": ping}
        self.do("REPORT_SCHEDULE")
        self.do("REPORT_SCHEDULE_DETAIL")
        self.do("RESET_SCHEDULE")

    def _onboard(self) -> None:
        """Sequences, stores, event actions, check-sums and the command log."""
        ping = self._catalogue.build("PING", {}, self._link.next_sequence())
        loaded = 2 * (ping + struct.pack(">I", DELAY_MS))
        self.kept |= {"request": ping, "sequence": loaded}
        self.do("LOAD_SEQUENCE", sequence="1", entries=loaded.hex())
        for name in ("CHECK_SEQUENCE", "REPORT_SEQUENCE", "START_SEQUENCE"):
            self.do(name, sequence="1")
        self.do("REPORT_SEQUENCES")
        self.do("ABORT_SEQUENCES")
        self.do("UNLOAD_SEQUENCE", sequence="1")
        named = {"apid": "100", "event": "STOPPED"}
        self.do("ADD_EVENT_ACTION", **named, request=ping.hex())
        self.do("REPORT_EVENT_ACTION", **named)
        self.do("REPORT_EVENT_ACTION_STATUS")
        self.do("DELETE_EVENT_ACTIONS")
        self.do("REPORT_STORE_CONTENT", store="EVENTS")
        self.do("REPORT_STORE_STATUS")
        self.do("CHECK_OBJECT", memory="FILES", base="files/tour.bin", offset="0", length="0")
        self.do("COMMAND_LOG_DUMP", entries="50")

    def _refusals(self) -> None:
        assert self.tell("REC_START").outcome is VerificationOutcome.FAILED  # it is recording
        assert self.tell("TBL_VALIDATE", table="NOISE").outcome is VerificationOutcome.REJECTED
        ping = bytearray(self._catalogue.build("PING", {}, self._link.next_sequence())[:-2])
        ping[1] ^= 1  # another application
        crc = binascii.crc_hqx(ping, 0xFFFF).to_bytes(2, "big")
        assert self._follow(bytes(ping) + crc).outcome is VerificationOutcome.REJECTED

    def _monitors(self) -> None:
        crc32 = str(zlib.crc32(MONITORS))
        self.do("SET_MODE", mode="STANDBY")
        self.do("TBL_LOAD", table="MONITORS", size_bytes=str(len(MONITORS)), crc32=crc32)
        self.do("TBL_DATA", table="MONITORS", offset="0", data=MONITORS.hex())
        self.do("TBL_VALIDATE", table="MONITORS")
        self.do("TBL_ACTIVATE", table="MONITORS", crc32=crc32)
        self.do("SET_MODE", mode="IDENTIFY")
        self.do("REPORT_MONITOR", monitor="9")
        until_s = time.monotonic() + PATIENCE_S
        while self._status() == "UNCHECKED":
            assert time.monotonic() < until_s
        self.do("TBL_DUMP", table="MONITORS", copy="ACTIVE")
        self.do("REPORT_FILE_ATTRIBUTES", path="files/tables/monitors_active.yaml")
        self.wait("tables")
        self.wait("recorder")
