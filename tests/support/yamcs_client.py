"""Works with the daemon through a running Yamcs; in an environment of its own.

python yamcs_client.py HTTP_PORT  ->  one JSON line: commands with their stages, parameters, alarms
"""

import json
import sys
import time
from typing import Any

from yamcs.client import ConnectionFailure, YamcsClient

PATIENCE_S = 600.0
INSTANCE = "inertia"
SENT: tuple[tuple[str, dict[str, Any]], ...] = (
    ("PING", {}),
    ("REPORT_SET", {"sid": "HEALTH"}),
    ("TBL_VALIDATE", {"table": "NOISE"}),  # nothing is staged
    ("RUN_BATCH", {"method": "FUSED", "unknown": "TARGET", "last_s": 10.0}),
)
SHOWN = ("health_mode", "health_met_s", "estimate_target_mass_kg", "estimate_valid")


def wait_for(condition: Any) -> Any:
    """Return the condition's value once it is true; raises TimeoutError."""
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s:
        value = condition()
        if value:
            return value
        time.sleep(0.2)
    raise TimeoutError


def _connect(port: int) -> YamcsClient | None:
    """Return a client once the server listens and its instance runs."""
    try:
        client = YamcsClient(f"http://127.0.0.1:{port}")
        states = {item.name: item.state for item in client.list_instances()}
        return client if states.get(INSTANCE) == "RUNNING" else None
    except ConnectionFailure:
        return None


def give(connection: Any, name: str, arguments: dict[str, Any]) -> dict[str, Any]:
    """Send one command; return what Yamcs made of its verification."""
    command = connection.issue(f"/{INSTANCE}/{name}", args=arguments)
    wait_for(command.is_complete)
    return {
        "name": name,
        "success": command.is_success(),
        "error": command.error,
        "stages": {key: ack.status for key, ack in command.acknowledgments.items()},
    }


def main(port: int) -> int:
    client = wait_for(lambda: _connect(port))
    processor = client.get_processor(INSTANCE, "realtime")
    names = [f"/{INSTANCE}/{name}" for name in SHOWN]
    wait_for(lambda: all(v is not None for v in processor.get_parameter_values(names)))
    connection = processor.create_command_connection()
    link = next(iter(client.list_links(INSTANCE)))
    database = client.get_mdb(INSTANCE)
    values = dict(zip(SHOWN, processor.get_parameter_values(names), strict=True))
    found = {
        "sent": [give(connection, name, arguments) for name, arguments in SENT],
        "values": {name: value.eng_value for name, value in values.items()},
        "monitoring": {name: value.monitoring_result for name, value in values.items()},
        "dates": {name: value.generation_time.isoformat() for name, value in values.items()},
        "significance": {
            name: str(database.get_command(f"/{INSTANCE}/{name}").significance)
            for name in ("PING", "RESTART")
        },
        "link": [link.status, link.in_count, link.out_count],
        "invalid": [e.message for e in client.get_archive(INSTANCE).list_events()][:20],
    }
    sys.stdout.write(json.dumps(found) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
