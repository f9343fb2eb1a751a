"""Loads the COSMOS export with openc3 and works with it; in an environment of its own.

python openc3_client.py FOLDER            ->  one JSON line: what is loaded, and its warnings
python openc3_client.py FOLDER PORT       ->  and what became of commands sent to the daemon
"""

import importlib
import json
import sys
import time
from pathlib import Path
from typing import Any

from openc3.interfaces.tcpip_client_interface import TcpipClientInterface
from openc3.packets.commands import Commands
from openc3.packets.packet_config import PacketConfig
from openc3.packets.telemetry import Telemetry

TARGET = "INERTIA"
PATIENCE_S = 120.0
SENT = (("PING", {}), ("REPORT_SET", {"SID": "HEALTH"}), ("TBL_DATA", {"DATA": "\x01\x02\x03"}))
COUNT_MASK = 0x3FFF


class System:
    """What openc3's own classes ask of a system: one configuration."""

    def __init__(self, config: PacketConfig) -> None:
        self.commands = Commands(config, self)
        self.telemetry = Telemetry(config, self)
        self.limits_set = "DEFAULT"


def load(folder: Path) -> PacketConfig:
    """Return the configuration as openc3 reads it; what it does not take raises."""
    config = PacketConfig()
    for name in ("tlm.txt", "cmd.txt"):
        config.process_file(str(folder / name), TARGET)
    return config


def interface(folder: Path, port: int) -> TcpipClientInterface:
    """Return the interface of the plugin, with its protocols in their order."""
    made = TcpipClientInterface("127.0.0.1", port, port, 10.0, None)
    for line in (folder / "plugin.txt").read_text().splitlines():
        words = line.split()
        if words[:1] == ["PROTOCOL"]:
            module = Path(words[2]).stem
            name = "".join(part.capitalize() for part in module.split("_"))
            kind = getattr(importlib.import_module(f"openc3.interfaces.protocols.{module}"), name)
            made.add_protocol(kind, words[3:], words[1])
    return made


def follow(system: System, link: TcpipClientInterface) -> list[dict[str, Any]]:
    """Send commands; return how each was verified, with the telemetry that came meanwhile."""
    found = []
    for count, (name, given) in enumerate(SENT, start=700):
        command = system.commands.build_cmd(
            TARGET, name, given | {"HEADER_SEQUENCE": 0xC000 | count}
        )
        link.write(command)
        reports: list[str] = []
        seen: dict[str, int] = {}
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s and reports[-1:] not in (
            ["COMPLETION_SUCCESS"],
            ["COMPLETION_FAILURE"],
            ["ACCEPTANCE_FAILURE"],
        ):
            raw = link.read().buffer
            packet = system.telemetry.identify(raw, [TARGET])
            if packet is None:
                continue
            packet.buffer = raw
            seen[packet.packet_name] = seen.get(packet.packet_name, 0) + 1
            named = "REQUEST_SEQUENCE" in packet.items
            if named and packet.read("REQUEST_SEQUENCE") & COUNT_MASK == count:
                reports.append(packet.packet_name)
        found.append({"name": name, "reports": reports, "seen": seen})
    return found


def main(folder: Path, port: int | None) -> int:
    config = load(folder)
    commands, telemetry = config.commands[TARGET], config.telemetry[TARGET]
    result: dict[str, Any] = {
        "commands": sorted(commands),
        "telemetry": sorted(telemetry),
        "hazardous": sorted(name for name, item in commands.items() if item.hazardous),
        "limits": {
            name: {i.name: i.limits.values["DEFAULT"] for i in item.limits_items if i.limits.values}
            for name, item in telemetry.items()
        },
        "warnings": config.warnings,
    }
    if port is not None:
        link = interface(folder, port)
        link.connect()
        try:
            result["sent"] = follow(System(config), link)
        finally:
            link.disconnect()
    sys.stdout.write(json.dumps(result) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else None))
